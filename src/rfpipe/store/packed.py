"""Folders of which every content is kept once: files under the digests of what they hold.

What files say twice, such as the brackets of one dark camera before a thousand scenes, is stored
once; and unlike links, it stays so when the folder is copied, zipped or published.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.store.places import Place, Range, ranges_of_file

__all__ = ["INDEX", "PackedPlace", "Sizes", "pack", "packed_in", "unpack"]

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


def pack(folder: Path, files: Iterable[Path], output: Path, about: Mapping[str, Any]) -> Sizes:
    """Store files by what they hold; a pack that was stopped is gone on with.

    Parameters
    ----------
    folder : Path
        To which the files' names are relative.
    files : iterable of Path
        In `folder`.
    output : Path
        A new folder, or one to go on with.
    about : mapping
        Plain data to keep with them.

    Raises
    ------
    StoreError
        When a file can't be read, or the disk is full.
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
    text = json.dumps({"kind": _KIND, "version": 1, "about": dict(about), "files": index}, indent=0)
    whole = hashlib.sha256(text.encode()).hexdigest()
    lines = [f"{digest}  {_object(digest)}" for digest in sorted(sizes)]
    write_atomically(output / _LIST, "\n".join([*lines, f"{whole}  {INDEX}", ""]).encode())
    write_atomically(output / INDEX, text.encode())
    return _sizes(index)


def unpack(place: PackedPlace, output: Path) -> Sizes:
    """Write the files of a packed folder as they were, each checked against its digest.

    Raises
    ------
    IntegrityError
        When one is damaged.
    StoreError
        When the disk is full, or another file stands in the way.
    """

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
    """Open a packed folder where it lies, None where something else does.

    Raises
    ------
    IntegrityError
        When its index is damaged, or names files outside of the folder.
    """
    if isinstance(base, Path):
        file = base / INDEX
        content = file.read_bytes() if file.is_file() else None
    else:
        content = base.read_many([INDEX]).get(INDEX)
    if content is None:
        return None
    try:
        found = json.loads(content)
        index = {name: (str(digest), int(size)) for name, (digest, size) in found["files"].items()}
        is_ours = found["kind"] == _KIND and all(map(_is_inside, index))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(
            f"{base}/{INDEX}: damaged, or no index of a packed folder ({error!r}); fetch it anew"
        ) from error
    if not is_ours:
        raise IntegrityError(f"{base}/{INDEX}: is no index of a packed folder; fetch it anew")
    return PackedPlace(base, index, found["about"])


class PackedPlace(Place):
    """A file or folder of those that are packed.

    Parameters
    ----------
    base : Path or Place
        The packed folder.
    index : mapping of str to (str, int)
        Digest and bytes of the files by name.
    about : mapping
        What was kept with them.
    key : str
    """

    def __init__(
        self,
        base: Path | Place,
        index: Mapping[str, tuple[str, int]],
        about: Mapping[str, Any],
        key: str = "",
    ) -> None:
        super().__init__(key)
        self.base, self.index, self.about = base, index, about

    def __str__(self) -> str:
        return f"{self.base}/{self.key}" if self.key else str(self.base)

    def at(self, key: str) -> PackedPlace:
        """Return another place in the same whole."""
        return PackedPlace(self.base, self.index, self.about, key)

    def read_bytes(self) -> bytes:
        """Read a file, and check that it is what its name says."""
        try:
            digest, _ = self.index[self.key]
        except KeyError:
            raise FileNotFoundError(str(self)) from None
        stored = self.base / _object(digest)
        try:
            content = stored.read_bytes()
        except FileNotFoundError:
            raise IntegrityError(
                f"{stored}: is missing, of {self.key}; copy or fetch {self.base} anew"
            ) from None
        if hashlib.sha256(content).hexdigest() != digest:
            raise IntegrityError(
                f"{stored}: damaged, of {self.key}; copy or fetch {self.base} anew"
            )
        return content

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file, which can't be compared with its name."""
        return ranges_of_file(self._stored()[0], ranges)

    def read_end(self, nbytes: int) -> tuple[bytes, int]:
        """Read the last bytes of a file; these and the file's size. As `read_ranges`."""
        stored, size = self._stored()
        return ranges_of_file(stored, [(max(0, size - nbytes), size)])[0], size

    def _stored(self) -> tuple[Path | Place, int]:
        """Where this file's content lies, and its bytes."""
        if self.key not in self.index:
            raise FileNotFoundError(str(self))
        digest, size = self.index[self.key]
        return self.base / _object(digest), size

    def open(self) -> IO[bytes]:
        """Open a file for reading, after its check."""
        return io.BytesIO(self.read_bytes())

    def files(self) -> list[str]:
        """Keys, relative to this one, of all files in this folder."""
        prefix = f"{self.key}/" if self.key else ""
        return sorted(name.removeprefix(prefix) for name in self.index if name.startswith(prefix))

    def nbytes(self) -> int:
        """Bytes of all files in this folder, those that others share with it as well."""
        prefix = f"{self.key}/" if self.key else ""
        return sum(size for name, (_, size) in self.index.items() if name.startswith(prefix))


def _object(digest: str) -> str:
    return f"{_OBJECTS}/{digest[:2]}/{digest}"


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts)


def _sizes(index: Mapping[str, Any]) -> Sizes:
    contents = dict(index.values())
    total = sum(size for _, size in index.values())
    return Sizes(len(index), total, len(contents), sum(contents.values()))
