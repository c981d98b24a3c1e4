"""Packed folders: every content stored once, under its SHA-256.

Unlike links, this also saves space when the folder is copied, zipped or published.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.store.places import (
    CHECKSUMS,
    ListedPlace,
    Place,
    Range,
    content_of,
    read_ranges,
    readable_content,
)

_INDEX = "packed.json"  # names, digests and sizes of packed files; written last
_KIND = "rfpipe packed folder"
_DOWNLOADS_AT_ONCE = 16  # latency, not bandwidth, limits downloads of small files


class PackedPlace(ListedPlace):
    """A file or folder in the packed folder `base`; `index` has SHA-256 and size by name."""

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
        """Read a file, and verify its SHA-256."""
        content = content_of(self._stored)
        if content is None or hashlib.sha256(content).hexdigest() != self.index[self.key][0]:
            problem = "is missing" if content is None else "is damaged"
            raise IntegrityError(
                f"{self._stored}: {problem} (content of {self.key}); copy or fetch {self.base} "
                "again"
            )
        return content

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read ranges of a file, without verifying its SHA-256."""
        return read_ranges(self._stored, ranges)

    @property
    def _sizes(self) -> Mapping[str, int]:
        return {name: size for name, (_, size) in self.index.items()}

    @property
    def _stored(self) -> Path | Place:
        if self.key not in self.index:
            raise FileNotFoundError(str(self))
        return self.base / _object(self.index[self.key][0])


def pack_files(folder: Path, files: Iterable[Path], output: Path) -> dict[str, tuple[str, int]]:
    """Store files of a folder by the SHA-256 of their contents; return it and the size by name.

    An interrupted call can be repeated, and skips stored contents.
    """
    index: dict[str, tuple[str, int]] = {}
    for file in sorted(files):
        with storage_errors(file, "reading"):
            content = file.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        stored = output / _object(digest)
        if not (stored.exists() and stored.read_bytes() == content):
            write_atomically(stored, content)
        index[file.relative_to(folder).as_posix()] = digest, len(content)
    text = json.dumps(
        {"kind": _KIND, "version": 1, "about": {"of": "results"}, "files": index}, indent=0
    )
    lines = sorted({f"{digest}  {_object(digest)}" for digest, _ in index.values()})
    index_digest = hashlib.sha256(text.encode()).hexdigest()
    write_atomically(
        output / CHECKSUMS, "\n".join([*lines, f"{index_digest}  {_INDEX}", ""]).encode()
    )
    write_atomically(output / _INDEX, text.encode())
    return index


def unpack_files(place: PackedPlace, output: Path) -> None:
    """Restore the files of a packed folder, each verified by its digest."""

    def write(name: str) -> None:
        target = output / name
        if not target.exists():
            write_atomically(target, (place / name).read_bytes())
            return
        with storage_errors(target, "reading"):
            digest = hashlib.sha256(target.read_bytes()).hexdigest()
        if digest != place.index[name][0]:
            raise StoreError(f"{target}: exists with another content; unpack into an empty folder")

    with ThreadPoolExecutor(1 if isinstance(place.base, Path) else _DOWNLOADS_AT_ONCE) as pool:
        for _ in pool.map(write, place.index):
            pass


def packed_in(base: Path | Place) -> PackedPlace | None:
    """Open a packed folder; None if `base` isn't one."""
    content = readable_content(base / _INDEX)
    if content is None:
        return None
    try:
        data = json.loads(content)
        index = {name: (str(digest), int(size)) for name, (digest, size) in data["files"].items()}
        if data["kind"] != _KIND or not all(map(_is_inside, index)):
            raise ValueError("of another kind")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(
            f"{base}/{_INDEX}: isn't the index of a packed folder, or is damaged ({error!r}); "
            "fetch it again"
        ) from error
    return PackedPlace(base, index)


def _object(digest: str) -> str:
    return f"objects/{digest[:2]}/{digest}"


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts)
