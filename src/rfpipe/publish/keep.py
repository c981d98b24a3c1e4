"""Keeping a run's results in a bucket: what somebody else reads, while captures stay at the rig.

S3 knows no folders: an object is there as a whole or not at all, but of a store of many objects
any part may be there. So each transport goes into the bucket as one object, a zip file that is read
by ranges. A list of all objects with their SHA-256 is written last, and tells what to skip when an
upload that was interrupted goes on.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.publish.contents import Acquisition, Run, files_of_store
from rfpipe.publish.writing import writing
from rfpipe.store import StoreLock
from rfpipe.store.bucket import Bucket
from rfpipe.store.files import remove_tree, storage_errors
from rfpipe.transport.places import MANIFEST, ZIP_NAME

__all__ = ["Kept", "keep"]

_SECONDS_BETWEEN_LISTS = 5.0
_BLOCK_BYTES = 2**20

_log = logging.getLogger(__name__)


@dataclass
class Kept:
    """What lies in a bucket.

    Attributes
    ----------
    address : str
    objects, nbytes : int
        All that the run has there.
    sent, nbytes_sent : int
        Objects that weren't there yet, or were others, and their bytes.
    """

    address: str
    objects: int = 0
    nbytes: int = 0
    sent: int = 0
    nbytes_sent: int = 0


def keep(run: Run, address: str, tell: Callable[[str], object] | None = None) -> Kept:
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
    kept = Kept(bucket.address)
    with StoreLock(made):
        try:
            listed = _List(bucket)
            _warn_of_others(listed, run, bucket.address)
            for name, source in _objects(run, made):
                digest, size = _measured(source)
                kept.objects += 1
                kept.nbytes += size
                if not listed.has(name, digest, size):
                    if tell is not None:
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
        lines = (bucket.read(MANIFEST) or b"").decode(errors="replace").splitlines()
        digests = {line[66:]: line[:64] for line in lines}
        self._digests = {name: digests[name] for name in digests if name in self._sizes}
        self._changed = self._digests != digests
        self._written = time.monotonic()

    @property
    def names(self) -> list[str]:
        """Of the objects that are there, sorted."""
        return sorted(self._digests)

    def has(self, name: str, digest: str, size: int) -> bool:
        return self._digests.get(name) == digest and self._sizes.get(name) == size

    def send(self, name: str, source: Path | bytes, digest: str, size: int) -> None:
        if self._digests.pop(name, None) is not None:
            self._write()  # nobody is told that the old one is there
        self._bucket.put(name, source)
        self._digests[name], self._sizes[name] = digest, size
        self._changed = True
        if time.monotonic() - self._written > _SECONDS_BETWEEN_LISTS:
            self._write()

    def finish(self) -> None:
        """Compare the sizes of all objects with what was sent, and write the list."""
        found = self._bucket.sizes()
        wrong = sorted(name for name in self._digests if found.get(name) != self._sizes[name])
        for name in wrong:
            del self._digests[name]
        if self._changed or wrong:
            self._write()
        if wrong:
            raise StoreError(
                f"{self._bucket.address}: {', '.join(wrong)} isn't there as it was sent; does "
                "somebody else write there? Run again: what is whole stays"
            )

    def _write(self) -> None:
        lines = (f"{digest}  {name}\n" for name, digest in sorted(self._digests.items()))
        self._bucket.put(MANIFEST, "".join(lines).encode())
        self._written = time.monotonic()


def _warn_of_others(listed: _List, run: Run, address: str) -> None:
    """Say that transports are there which this run doesn't have: those of the same name go."""
    own = {f"{acquisition.name}/{ZIP_NAME}" for acquisition in run.acquisitions}
    others = [name for name in listed.names if name.endswith(f"/{ZIP_NAME}") and name not in own]
    if others:
        _log.warning(
            "%s: has %d transports that this run hasn't, such as %s: of scenes that were removed, "
            "or of another run, whose objects of the same names are replaced; each run needs an "
            "address of its own",
            *(address, len(others), others[0]),
        )


def _objects(run: Run, made: Path) -> Iterator[tuple[str, Path | bytes]]:
    """Yield name and content of all objects; zip files are there until the next is asked for."""
    for acquisition in run.acquisitions:
        acquisition.check()
        yield _zipped(acquisition, "transport", made / ZIP_NAME)
    for acquisition in run.acquisitions:
        if (acquisition.folder / "relight.json").is_file():
            yield _zipped(acquisition, "relight", made / "relight.zip")
    provenance = made / "provenance.zip"
    files = [*run.manifests()]
    if files:
        _write_zip(provenance, files)
        yield provenance.name, provenance
    yield from run.report_files()


def _zipped(acquisition: Acquisition, stage: str, output: Path) -> tuple[str, Path]:
    """Make a zip file of a stage's store and manifest; the same bytes of the same ones."""
    store = acquisition.folder / f"{stage}.zarr"
    files = [*files_of_store(store, store.name)]
    _write_zip(output, [*files, (f"{stage}.json", acquisition.folder / f"{stage}.json")])
    return f"{acquisition.name}/{output.name}", output


def _write_zip(output: Path, files: list[tuple[str, Path]]) -> None:
    needed = sum(file.stat().st_size for _, file in files)
    with writing(output, overwrite=True, needed_bytes=needed) as writer:
        for name, file in files:
            writer.add(name, file)


def _measured(source: Path | bytes) -> tuple[str, int]:
    """Return SHA-256 and size of an object."""
    if isinstance(source, bytes):
        return hashlib.sha256(source).hexdigest(), len(source)
    digest = hashlib.sha256()
    with storage_errors(source, "reading"), source.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
        return digest.hexdigest(), file.tell()
