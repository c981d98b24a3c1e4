"""Keeping a run's results in a bucket: what somebody else reads, while captures stay at the rig.

S3 knows no folders: an object is there as a whole or not at all, but of a store of many objects
any part may be there. So each transport goes into the bucket as one object, a zip file that is read
by ranges. A list of all objects with their SHA-256 is written last, and tells what to skip when an
upload that was interrupted goes on.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store import StoreLock
from rfpipe.store.files import remove_tree
from rfpipe.store.places import content_of
from rfpipe.transport.storage import MANIFEST, ZIP_NAME
from rfpipe_publish.addresses import Bucket
from rfpipe_publish.run import Acquisition, Run, Source, files_of_store
from rfpipe_publish.writing import measured, write_zip

_SECONDS_BETWEEN_LISTS = 5.0

_log = logging.getLogger(__name__)


@dataclass
class Kept:
    """What lies in a bucket: all objects of a run, and those that this call sent."""

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
    run : Run
    address : str
        ``s3://bucket/folder``: of this run alone.
    tell : callable, optional
        Called with the name of each object that is sent.

    Raises
    ------
    InputError
        When it is no such address, or the environment has no credentials.
    IntegrityError
        When a transport is damaged, or isn't the one that its manifest is about.
    LockedError
        When another process keeps this run.
    StoreError
        When the bucket is missing or may not be written, its server doesn't answer, or an object
        isn't what was sent.
    """
    bucket = Bucket(address)
    made = run.results / ".keep"
    kept = Kept(str(bucket))
    with StoreLock(made):
        try:
            listed = _List(bucket)
            _warn_of_others(listed, run, str(bucket))
            for name, source in _objects(run, made):
                digest, size = measured(source)
                kept.objects += 1
                kept.nbytes += size
                if not listed.has(name, digest, size):
                    tell(name)
                    listed.send(name, source, digest, size)
                    kept.sent += 1
                    kept.nbytes_sent += size
            listed.finish()
        finally:
            remove_tree(made)
    return kept


class _List:
    """The list of a bucket's objects, true at any moment: of what is sent it knows afterwards."""

    def __init__(self, bucket: Bucket) -> None:
        self._bucket = bucket
        self._sizes = bucket.sizes()
        lines = (content_of(bucket / MANIFEST) or b"").decode(errors="replace").splitlines()
        listed = {line[66:]: line[:64] for line in lines}
        self.digests = {name: listed[name] for name in listed if name in self._sizes}
        self._changed = self.digests != listed
        self._written = time.monotonic()

    def has(self, name: str, digest: str, size: int) -> bool:
        return self.digests.get(name) == digest and self._sizes.get(name) == size

    def send(self, name: str, source: Source, digest: str, size: int) -> None:
        if self.digests.pop(name, None) is not None:
            self._write()  # nobody is told that the old one is there
        self._bucket.put(name, source)
        self.digests[name], self._sizes[name] = digest, size
        self._changed = True
        if time.monotonic() - self._written > _SECONDS_BETWEEN_LISTS:
            self._write()

    def finish(self) -> None:
        """Compare the sizes of all objects with what was sent, and write the list."""
        found = self._bucket.sizes()
        wrong = sorted(name for name in self.digests if found.get(name) != self._sizes[name])
        for name in wrong:
            del self.digests[name]
        if self._changed or wrong:
            self._write()
        if wrong:
            raise StoreError(
                f"{self._bucket}: {', '.join(wrong)} isn't there as it was sent; does somebody "
                "else write there? Run again: what is whole stays"
            )

    def _write(self) -> None:
        lines = (f"{digest}  {name}\n" for name, digest in sorted(self.digests.items()))
        self._bucket.put(MANIFEST, "".join(lines).encode())
        self._written = time.monotonic()


def _warn_of_others(listed: _List, run: Run, address: str) -> None:
    """Say that transports are there which this run doesn't have: those of the same name go."""
    own = {f"{acquisition.name}/{ZIP_NAME}" for acquisition in run.acquisitions}
    others = sorted(name for name in {*listed.digests} - own if name.endswith(f"/{ZIP_NAME}"))
    if others:
        _log.warning(
            "%s: has %d transports that this run hasn't, such as %s: of scenes that were removed, "
            "or of another run, whose objects of the same names are replaced; each run needs an "
            "address of its own",
            *(address, len(others), others[0]),
        )


def _objects(run: Run, made: Path) -> Iterator[tuple[str, Source]]:
    """Yield name and source of all objects; zip files are there until the next is asked for."""
    for acquisition in run.acquisitions:
        acquisition.check()
        yield _zipped(acquisition, "transport", made / ZIP_NAME)
    for acquisition in run.acquisitions:
        if (acquisition.folder / "relight.json").is_file():
            yield _zipped(acquisition, "relight", made / "relight.zip")
    provenance = made / "provenance.zip"
    files = [*run.manifests()]
    if files:
        write_zip(provenance, files)
        yield provenance.name, provenance
    yield from run.report_files()


def _zipped(acquisition: Acquisition, stage: str, output: Path) -> tuple[str, Path]:
    """Make a zip file of a stage's store and manifest."""
    store, manifest = f"{stage}.zarr", f"{stage}.json"
    files = [*files_of_store(acquisition.folder / store, store)]
    write_zip(output, [*files, (manifest, acquisition.folder / manifest)])
    return f"{acquisition.name}/{output.name}", output
