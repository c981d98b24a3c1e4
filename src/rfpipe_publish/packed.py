"""Folders of which every content is kept once: files under the digests of what they hold.

What files say twice, such as the brackets of one dark camera before a thousand scenes, is stored
once; and unlike links, it stays so when the folder is copied, zipped or published.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.store.places import Place, Range, content_of, read_ranges

INDEX = "packed.json"
"""Names, digests and sizes of the files; written last."""

_LIST = "manifest-sha256.txt"
_OBJECTS = "objects"
_KIND = "rfpipe packed folder"
_AT_ONCE = 16  # files fetched from an address: each waits for the way there and back


@dataclass(frozen=True)
class Sizes:
    """What a packed folder holds.

    Attributes
    ----------
    files, nbytes : int
        Of the folder as it was.
    objects, stored : int
        Different contents among them, and their bytes.
    """

    files: int
    nbytes: int
    objects: int
    stored: int


def pack(folder: Path, files: Iterable[Path], output: Path) -> Sizes:
    """Store files by what they hold; a pack that was stopped is gone on with.

    Parameters
    ----------
    folder : Path
        To which the files' names are relative.
    files : iterable of Path
        In `folder`.
    output : Path
        A new folder, or one to go on with.
    """
    index: dict[str, list[Any]] = {}
    sizes: dict[str, int] = {}
    for file in sorted(files):
        with storage_errors(file, "reading"):
            content = file.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        index[file.relative_to(folder).as_posix()] = [digest, len(content)]
        stored = output / _object(digest)
        if digest not in sizes and not (stored.exists() and stored.read_bytes() == content):
            stored.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(stored, content)
        sizes[digest] = len(content)
    text = json.dumps(
        {"kind": _KIND, "version": 1, "about": {"of": "results"}, "files": index}, indent=0
    )
    whole = hashlib.sha256(text.encode()).hexdigest()
    lines = [f"{digest}  {_object(digest)}" for digest in sorted(sizes)]
    write_atomically(output / _LIST, "\n".join([*lines, f"{whole}  {INDEX}", ""]).encode())
    write_atomically(output / INDEX, text.encode())
    return _sizes(index)


def unpack(place: PackedPlace, output: Path) -> Sizes:
    """Write the files of a packed folder as they were, each checked against its digest."""

    def write(name: str) -> None:
        target = output / name
        if target.exists():
            with storage_errors(target, "reading"):
                digest = hashlib.sha256(target.read_bytes()).hexdigest()
            if digest != place.index[name][0]:
                raise StoreError(f"{target}: another file stands here; unpack into an empty folder")
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target, (place / name).read_bytes())

    with ThreadPoolExecutor(1 if isinstance(place.base, Path) else _AT_ONCE) as pool:
        for _ in pool.map(write, place.index):
            pass
    return _sizes(place.index)


def packed_in(base: Path | Place) -> PackedPlace | None:
    """Open a packed folder where it lies, None where something else does."""
    content = content_of(base / INDEX)
    if content is None:
        return None
    try:
        found = json.loads(content)
        index = {name: (str(digest), int(size)) for name, (digest, size) in found["files"].items()}
        if found["kind"] != _KIND or not all(map(_is_inside, index)):
            raise ValueError("of another kind")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(
            f"{base}/{INDEX}: damaged, or no index of a packed folder ({error!r}); fetch it anew"
        ) from error
    return PackedPlace(base, index)


class PackedPlace(Place):
    """A file or folder of those that are packed.

    Parameters
    ----------
    base : Path or Place
        The packed folder.
    index : mapping of str to (str, int)
        Digest and bytes of the files by name.
    key : str
    """

    def __init__(
        self, base: Path | Place, index: Mapping[str, tuple[str, int]], key: str = ""
    ) -> None:
        super().__init__(key)
        self.base, self.index = base, index

    def __str__(self) -> str:
        return f"{self.base}/{self.key}".rstrip("/")

    def at(self, key: str) -> PackedPlace:
        return PackedPlace(self.base, self.index, key)

    def read_bytes(self) -> bytes:
        """Read a file, and check that it is what its name says."""
        stored, digest = self._stored
        content = content_of(stored)
        if content is None or hashlib.sha256(content).hexdigest() != digest:
            what = "is missing" if content is None else "damaged"
            raise IntegrityError(f"{stored}: {what}, of {self.key}; copy or fetch {self.base} anew")
        return content

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file, which can't be compared with its name."""
        return read_ranges(self._stored[0], ranges)

    def files(self) -> list[str]:
        return sorted(name[len(self._prefix) :] for name in self._inside)

    def nbytes(self) -> int:
        """Return the bytes of all files in this folder, those that others share as well."""
        return sum(size for _, size in self._inside.values())

    @property
    def _prefix(self) -> str:
        return f"{self.key}/" if self.key else ""

    @property
    def _inside(self) -> dict[str, tuple[str, int]]:
        return {name: of for name, of in self.index.items() if name.startswith(self._prefix)}

    @property
    def _stored(self) -> tuple[Path | Place, str]:
        """Where this file's content lies, and its digest."""
        if self.key not in self.index:
            raise FileNotFoundError(str(self))
        digest, _ = self.index[self.key]
        return self.base / _object(digest), digest


def _object(digest: str) -> str:
    return f"{_OBJECTS}/{digest[:2]}/{digest}"


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts)


def _sizes(index: Mapping[str, Any]) -> Sizes:
    contents = dict(index.values())
    total = sum(size for _, size in index.values())
    return Sizes(len(index), total, len(contents), sum(contents.values()))
