"""Finding out where something lies: in a zip file, a packed folder, or behind an address."""

from __future__ import annotations

import lzma
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rfpipe.errors import IntegrityError, StoreError, UnreachableError
from rfpipe.store.places import METADATA, Place, Range, as_address, content_of, read_ranges
from rfpipe_publish.packed import packed_in

_ZIP = re.compile(r"^(.*?\.zip)(?:/+|$)", re.IGNORECASE)
# What `zipfile` raises on damaged bytes, and on a compression or encryption that it lacks.
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, OSError, RuntimeError, ValueError),
)
_HEADER_BYTES = 30  # before each file of a zip, without its name


def locate(path: str | Path | Place) -> Path | Place:
    """Find out where something lies; see `rfpipe.store.places.locate`."""
    if isinstance(path, Place):
        return _in_zip(path) if path.key.lower().endswith(".zip") else path
    address = as_address(path)
    if address is not None:
        from rfpipe_publish.addresses import ObjectPlace

        found = _ZIP.match(address)
        if found is not None:
            return _in_zip(ObjectPlace.of(found[1]), address[found.end() :])
        return _within_packed(ObjectPlace.of(address))
    for outer in (Path(path), *Path(path).parents):
        inside = Path(path).relative_to(outer).as_posix()
        if outer.suffix.lower() == ".zip" and outer.is_file():
            return _in_zip(outer, "" if inside == "." else inside)
        packed = packed_in(outer)
        if packed is not None:
            return packed.at("" if inside == "." else inside)
    return Path(path)


def _within_packed(place: Place) -> Place:
    """Return a place, or that in the packed folder around it: asked last, folder by folder."""
    if _there(place / METADATA):
        return place
    outer, inside = place, ""
    while True:
        if _there(outer / "packed.json"):
            packed = packed_in(outer)
            assert packed is not None
            return packed.at(inside)
        if not outer.key:
            return place
        above, _, name = outer.key.rpartition("/")
        outer, inside = outer.at(above), f"{name}/{inside}".rstrip("/")


def _there(file: Place) -> bool:
    try:
        return content_of(file) is not None
    except UnreachableError:
        raise
    except StoreError:  # a bucket that doesn't tell what it lacks
        return False


class ZipPlace(Place):
    """A folder or file in a zip file.

    Parameters
    ----------
    archive : zipfile.ZipFile
    file : Path or Place
        The zip file.
    key : str
    """

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
        wanted = (slice(*part).indices(info.file_size) for part in ranges)
        return read_ranges(self._file, [(first + start, first + stop) for start, stop, _ in wanted])

    def open(self) -> IO[bytes]:
        """Open a file for reading; its checksum is checked at its end."""
        with self._damage():
            return self._archive.open(self._info)

    def files(self) -> list[str]:
        return [info.filename[len(self._prefix) :] for info in self._infos]

    def nbytes(self) -> int:
        return sum(info.compress_size for info in self._infos)

    @property
    def _info(self) -> zipfile.ZipInfo:
        try:
            return self._archive.getinfo(self.key)
        except KeyError:
            raise FileNotFoundError(str(self)) from None

    @property
    def _infos(self) -> list[zipfile.ZipInfo]:
        found = (info for info in self._archive.infolist() if not info.is_dir())
        inside = [info for info in found if info.filename.startswith(self._prefix)]
        return sorted(inside, key=lambda info: info.filename)

    @property
    def _prefix(self) -> str:
        return f"{self.key}/" if self.key else ""

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
