"""Upload of a run's results to a bucket; captured frames stay at the rig.

Writing an object is atomic, so each transport is a single object: a zip file, read by ranges. A
list of all objects with their SHA-256 in the bucket lets an interrupted upload skip complete ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rfpipe.publishing.run import FinishedAcquisition, RunFolder, files_below
from rfpipe.publishing.writing import Source, digest_and_size, write_zip
from rfpipe.store import StoreLock
from rfpipe.store.addresses import Bucket
from rfpipe.store.files import remove_tree
from rfpipe.store.places import CHECKSUMS, content_of

_SECONDS_BETWEEN_LISTS = 5.0


@dataclass
class UploadSummary:
    """Numbers and bytes of a run's objects in a bucket, and of those sent by this upload."""

    address: str
    objects: int = 0
    nbytes: int = 0
    sent: int = 0
    nbytes_sent: int = 0


def keep(
    run: RunFolder, address: str, on_upload: Callable[[str], object] = lambda _: None
) -> UploadSummary:
    """Upload a run's transports, relit pictures, manifests and report to a bucket.

    Objects that are unchanged in the bucket are skipped. An interrupted upload can be repeated.

    Parameters
    ----------
    address : str
        ``s3://bucket/folder``, used by this run only.
    on_upload : callable, optional
        Called with the name of each object before it is sent.

    Raises
    ------
    InputError
        When the address isn't that of a bucket.
    IntegrityError
        When a transport is damaged, or its digest isn't that of its manifest.
    LockedError
        When another process uploads this run.
    StoreError
        When the bucket is missing or read-only, or its server doesn't answer.
    """
    bucket = Bucket(address)
    folder = run.results / ".keep"
    with StoreLock(folder):
        try:
            return _upload(_objects(run, folder), bucket, on_upload)
        finally:
            remove_tree(folder)


def _upload(
    objects: Iterable[tuple[str, Source]], bucket: Bucket, on_upload: Callable[[str], object]
) -> UploadSummary:
    """Send new and changed objects, and the list of all."""
    summary = UploadSummary(str(bucket))
    stored = _ObjectList(bucket)
    for name, source in objects:
        digest, size = digest_and_size(source)
        summary.objects += 1
        summary.nbytes += size
        if not stored.has(name, digest, size):
            on_upload(name)
            stored.send(name, source, digest)
            summary.sent += 1
            summary.nbytes_sent += size
    stored.write()
    return summary


class _ObjectList:
    """The list of a bucket's objects; it never lists an object that isn't complete."""

    def __init__(self, bucket: Bucket) -> None:
        self._bucket = bucket
        self._sizes = bucket.sizes()
        lines = (content_of(bucket / CHECKSUMS) or b"").decode(errors="replace").splitlines()
        self._written = {line[66:]: line[:64] for line in lines}
        self.digests = {
            name: digest for name, digest in self._written.items() if name in self._sizes
        }
        self._time = time.monotonic()

    def has(self, name: str, digest: str, size: int) -> bool:
        return self.digests.get(name) == digest and self._sizes[name] == size

    def send(self, name: str, source: Source, digest: str) -> None:
        if self.digests.pop(name, None) is not None:
            self.write()  # without the object that is replaced
        self._bucket.put(name, source)
        self.digests[name] = digest
        if time.monotonic() - self._time > _SECONDS_BETWEEN_LISTS:
            self.write()

    def write(self) -> None:
        """Write the list to the bucket, if it changed."""
        if self.digests != self._written:
            lines = (f"{digest}  {name}\n" for name, digest in sorted(self.digests.items()))
            self._bucket.put(CHECKSUMS, "".join(lines).encode())
            self._written, self._time = dict(self.digests), time.monotonic()


def _objects(run: RunFolder, temporary: Path) -> Iterator[tuple[str, Source]]:
    """Yield name and source of all objects; each zip file is replaced by the next one."""
    for acquisition in run.acquisitions:
        acquisition.check()
        yield _zipped_store(acquisition, "transport", temporary)
    for acquisition in run.acquisitions:
        if (acquisition.folder / "relight.json").is_file():
            yield _zipped_store(acquisition, "relight", temporary)
    manifests = [*run.manifests()]
    if manifests:
        write_zip(temporary / "provenance.zip", manifests)
        yield "provenance.zip", temporary / "provenance.zip"
    yield from run.report_files()


def _zipped_store(
    acquisition: FinishedAcquisition, stage: str, temporary: Path
) -> tuple[str, Path]:
    """Zip a stage's store and manifest; return the object's name, and the zip file."""
    store, manifest = f"{stage}.zarr", f"{stage}.json"
    files = [*files_below(acquisition.folder / store, store)]
    output = temporary / f"{stage}.zip"
    write_zip(output, [*files, (manifest, acquisition.folder / manifest)])
    return f"{acquisition.name}/{stage}.zip", output
