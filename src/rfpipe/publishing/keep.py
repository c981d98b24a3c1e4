"""Keeping a run's results in a bucket: what somebody else reads, while captures stay at the rig.

An object is there as a whole or not at all. So each transport is one, a zip file that is read by
ranges. A list of all objects with their SHA-256 tells what to skip when an interrupted upload goes
on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rfpipe.publishing.run import Run, files_below
from rfpipe.publishing.writing import Source, measured, write_zip
from rfpipe.store import StoreLock
from rfpipe.store.addresses import Bucket
from rfpipe.store.files import remove_tree
from rfpipe.store.places import CHECKSUMS, content_of

_SECONDS_BETWEEN_LISTS = 5.0


@dataclass
class Kept:
    """Objects of a run in a bucket, and those that this call sent."""

    address: str
    objects: int = 0
    nbytes: int = 0
    sent: int = 0
    nbytes_sent: int = 0


def keep(run: Run, address: str, tell: Callable[[str], object] = lambda _: None) -> Kept:
    """Bring a run's transports, relit pictures, manifests and report into a bucket.

    What is there already, and the same, isn't sent. May be cut off anywhere and called again.

    Parameters
    ----------
    address : str
        ``s3://bucket/folder``: of this run alone.
    tell : callable, optional
        Called with the name of each object that is sent.

    Raises
    ------
    InputError
        When it is no such address.
    IntegrityError
        When a transport is damaged, or isn't the one that its manifest is about.
    LockedError
        When another process keeps this run.
    StoreError
        When the bucket is missing or may not be written, or its server doesn't answer.
    """
    bucket = Bucket(address)
    folder = run.results / ".keep"
    total = Kept(str(bucket))
    with StoreLock(folder):
        try:
            listed = _List(bucket)
            for name, source in _objects(run, folder):
                digest, size = measured(source)
                total.objects += 1
                total.nbytes += size
                if not listed.has(name, digest, size):
                    tell(name)
                    listed.send(name, source, digest)
                    total.sent += 1
                    total.nbytes_sent += size
            listed.write()
        finally:
            remove_tree(folder)
    return total


class _List:
    """The list of a bucket's objects, true at any moment: of what is sent it knows afterwards."""

    def __init__(self, bucket: Bucket) -> None:
        self._bucket = bucket
        self._sizes = bucket.sizes()
        lines = (content_of(bucket / CHECKSUMS) or b"").decode(errors="replace").splitlines()
        self._written = {line[66:]: line[:64] for line in lines}
        self.digests = {name: of for name, of in self._written.items() if name in self._sizes}
        self._time = time.monotonic()

    def has(self, name: str, digest: str, size: int) -> bool:
        return self.digests.get(name) == digest and self._sizes[name] == size

    def send(self, name: str, source: Source, digest: str) -> None:
        if self.digests.pop(name, None) is not None:
            self.write()  # nobody is told that the old one is there
        self._bucket.put(name, source)
        self.digests[name] = digest
        if time.monotonic() - self._time > _SECONDS_BETWEEN_LISTS:
            self.write()

    def write(self) -> None:
        """Bring the list into the bucket, where it isn't the one there."""
        if self.digests != self._written:
            lines = (f"{digest}  {name}\n" for name, digest in sorted(self.digests.items()))
            self._bucket.put(CHECKSUMS, "".join(lines).encode())
            self._written, self._time = dict(self.digests), time.monotonic()


def _objects(run: Run, made: Path) -> Iterator[tuple[str, Source]]:
    """Yield name and source of all objects; zip files are there until the next is asked for."""
    for stage in ("transport", "relight"):
        for entry in run.acquisitions:
            store, manifest = f"{stage}.zarr", f"{stage}.json"
            if (entry.folder / manifest).is_file():
                if stage == "transport":
                    entry.check()
                files = [*files_below(entry.folder / store, store)]
                write_zip(made / f"{stage}.zip", [*files, (manifest, entry.folder / manifest)])
                yield f"{entry.name}/{stage}.zip", made / f"{stage}.zip"
    manifests = [*run.manifests()]
    if manifests:
        write_zip(made / "provenance.zip", manifests)
        yield "provenance.zip", made / "provenance.zip"
    yield from run.report_files()
