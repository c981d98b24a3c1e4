"""Where something lies: in a zip file, behind an address, or in a packed folder.

A packed folder holds every content once, under its SHA-256; unlike links, it stays so when it is
copied, zipped or published.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import re
import struct
import zipfile
import zlib
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from rfpipe.errors import IntegrityError, StoreError, UnreachableError
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.store.places import METADATA, Place, Range, as_address, content_of, read_ranges
from rfpipe.transport.storage import MANIFEST

_ZIP = re.compile(r"^(.*?\.zip)(?:/+|$)", re.IGNORECASE)
# What `zipfile` raises on damaged bytes, and on a compression or encryption that it lacks.
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, OSError, RuntimeError, ValueError),
)
_HEADER_BYTES = 30  # before each file of a zip, without its name
_INDEX = "packed.json"  # names, digests and sizes of packed files; written last
_KIND = "rfpipe packed folder"
_AT_ONCE = 16  # files fetched from an address: each waits for the way there and back


def locate(path: str | Path | Place) -> Path | Place:
    """Find out where something lies; see `rfpipe.store.places.locate`."""
    if isinstance(path, Place):
        return _in_zip(path) if path.key.lower().endswith(".zip") else path
    address = as_address(path)
    if address is not None:
        from rfpipe_publish.addresses import ObjectPlace

        match = _ZIP.match(address)
        if match is not None:
            return _in_zip(ObjectPlace.of(match[1]), address[match.end() :])
        return _within_packed(ObjectPlace.of(address))
    for outer in (Path(path), *Path(path).parents):
        inside = "/".join(Path(path).relative_to(outer).parts)
        if outer.suffix.lower() == ".zip" and outer.is_file():
            return _in_zip(outer, inside)
        packed = packed_in(outer)
        if packed is not None:
            return packed.at(inside)
    return Path(path)


def _in_zip(file: Path | Place, key: str = "") -> Place:
    try:
        archive = zipfile.ZipFile(file if isinstance(file, Path) else file.open())
    except FileNotFoundError:
        raise StoreError(f"{file}: no such file; check the address") from None
    except _DAMAGE as error:
        raise StoreError(
            f"{file}: can't be read as a zip file ({error}); is it whole? Fetch it anew"
        ) from error
    return _within_packed(ZipPlace(archive, file, key))


def _within_packed(place: Place) -> Place:
    """Return a place, or that in the packed folder around it: asked last, folder by folder."""
    if _content_of(place / METADATA) is None:
        parts = PurePosixPath(place.key).parts
        for n in range(len(parts), -1, -1):
            packed = packed_in(place.at("/".join(parts[:n])))
            if packed is not None:
                return packed.at("/".join(parts[n:]))
    return place


def _content_of(file: Path | Place) -> bytes | None:
    try:
        return content_of(file)
    except UnreachableError:
        raise
    except StoreError:  # a bucket that doesn't tell what it lacks
        return None


class _Listed(Place):
    """A folder or file of a whole whose files are listed, with their bytes."""

    @property
    @abstractmethod
    def _sizes(self) -> Mapping[str, int]: ...

    def files(self) -> list[str]:
        return sorted(name[len(self._prefix) :] for name in self._inside)

    def nbytes(self) -> int:
        return sum(self._sizes[name] for name in self._inside)

    @property
    def _prefix(self) -> str:
        return f"{self.key}/" if self.key else ""

    @property
    def _inside(self) -> list[str]:
        return [name for name in self._sizes if name.startswith(self._prefix)]


class ZipPlace(_Listed):
    """A folder or file in a zip file."""

    def __init__(self, archive: zipfile.ZipFile, file: Path | Place, key: str = "") -> None:
        super().__init__(key)
        self._archive, self._file = archive, file

    def __str__(self) -> str:
        return f"{self._file}/{self.key}".rstrip("/")

    def at(self, key: str) -> ZipPlace:
        return ZipPlace(self._archive, self._file, key)

    def read_bytes(self) -> bytes:
        """Read a file; its checksum is checked."""
        with self._damage():
            return self._archive.read(self._info)

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file, by ranges where it lies in the zip file as it is."""
        info = self._info
        if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
            return super().read_ranges(ranges)
        begin = info.header_offset
        (header,) = read_ranges(self._file, [(begin, begin + _HEADER_BYTES)])
        lengths = (int.from_bytes(header[at : at + 2], "little") for at in (26, 28))
        first = begin + _HEADER_BYTES + sum(lengths)
        bounds = (slice(*part).indices(info.file_size) for part in ranges)
        return read_ranges(self._file, [(first + start, first + stop) for start, stop, _ in bounds])

    def open(self) -> IO[bytes]:
        """Open a file for reading; its checksum is checked at its end."""
        with self._damage():
            return self._archive.open(self._info)

    @property
    def _info(self) -> zipfile.ZipInfo:
        try:
            return self._archive.getinfo(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None

    @property
    def _sizes(self) -> Mapping[str, int]:
        infos = self._archive.infolist()
        return {info.filename: info.compress_size for info in infos if not info.is_dir()}

    @contextmanager
    def _damage(self) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError:
            raise
        except RuntimeError as error:  # of a method that is missing, too
            raise StoreError(
                f"{self}: can't be unpacked ({error}); unpack {self._file} by what made it, or "
                "make it again without a password, its files stored as they are or deflated"
            ) from error
        except _DAMAGE as error:
            raise IntegrityError(f"{self}: damaged ({error}); fetch {self._file} anew") from error


class PackedPlace(_Listed):
    """A file or folder of those packed in `base`; `index` has SHA-256 and bytes by name."""

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
        content = content_of(self._stored)
        if content is None or hashlib.sha256(content).hexdigest() != self.index[self.key][0]:
            what = "is missing" if content is None else "damaged"
            raise IntegrityError(
                f"{self._stored}: {what}, of {self.key}; copy or fetch {self.base} anew"
            )
        return content

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file, which can't be compared with its name."""
        return read_ranges(self._stored, ranges)

    @property
    def _sizes(self) -> Mapping[str, int]:
        return {name: size for name, (_, size) in self.index.items()}

    @property
    def _stored(self) -> Path | Place:
        if self.key not in self.index:
            raise FileNotFoundError(str(self))
        return self.base / _object(self.index[self.key][0])


def pack(folder: Path, files: Iterable[Path], output: Path) -> dict[str, tuple[str, int]]:
    """Store files of a folder by what they hold; return SHA-256 and bytes by name.

    A pack that was stopped is gone on with.
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
    whole = hashlib.sha256(text.encode()).hexdigest()
    write_atomically(output / MANIFEST, "\n".join([*lines, f"{whole}  {_INDEX}", ""]).encode())
    write_atomically(output / _INDEX, text.encode())
    return index


def unpack(place: PackedPlace, output: Path) -> None:
    """Write the files of a packed folder as they were, each checked against its digest."""

    def write(name: str) -> None:
        target = output / name
        if not target.exists():
            write_atomically(target, (place / name).read_bytes())
            return
        with storage_errors(target, "reading"):
            digest = hashlib.sha256(target.read_bytes()).hexdigest()
        if digest != place.index[name][0]:
            raise StoreError(f"{target}: another file stands here; unpack into an empty folder")

    with ThreadPoolExecutor(1 if isinstance(place.base, Path) else _AT_ONCE) as pool:
        for _ in pool.map(write, place.index):
            pass


def packed_in(base: Path | Place) -> PackedPlace | None:
    """Open a packed folder where it lies, None where something else does."""
    content = _content_of(base / _INDEX)
    if content is None:
        return None
    try:
        facts = json.loads(content)
        index = {name: (str(digest), int(size)) for name, (digest, size) in facts["files"].items()}
        if facts["kind"] != _KIND or not all(map(_is_inside, index)):
            raise ValueError("of another kind")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(
            f"{base}/{_INDEX}: damaged, or no index of a packed folder ({error!r}); fetch it anew"
        ) from error
    return PackedPlace(base, index)


def _object(digest: str) -> str:
    return f"objects/{digest[:2]}/{digest}"


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts)
