"""Folders and files in zip files."""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.places import ListedPlace, Place, Range, read_ranges

# Raised by `zipfile` for damaged bytes and for unsupported compression or encryption.
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, OSError, RuntimeError, ValueError),
)
_HEADER_BYTES = 30  # local header of each file in a zip, without the file's name


def open_zip(file: Path | Place, key: str = "") -> ZipPlace:
    """Open a file or folder in a zip file, by its name in it.

    Raises
    ------
    StoreError
        When the zip file is missing or damaged.
    """
    try:
        archive = zipfile.ZipFile(file if isinstance(file, Path) else file.open())
    except FileNotFoundError:
        raise StoreError(f"{file}: no such file; check the address") from None
    except _DAMAGE as error:
        raise StoreError(
            f"{file}: can't be read as a zip file ({error}); it may be incomplete: fetch it again"
        ) from error
    return ZipPlace(archive, file, key)


class ZipPlace(ListedPlace):
    """A file or folder in a zip file."""

    def __init__(self, archive: zipfile.ZipFile, file: Path | Place, key: str = "") -> None:
        super().__init__(key)
        self._archive, self._file = archive, file

    def __str__(self) -> str:
        return f"{self._file}/{self.key}".rstrip("/")

    def at(self, key: str) -> ZipPlace:
        return ZipPlace(self._archive, self._file, key)

    def read_bytes(self) -> bytes:
        """Read a file, and verify its checksum."""
        with self._damage():
            return self._archive.read(self._info)

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read ranges of a file, directly from the zip file if it is stored uncompressed."""
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
        """Open a file for reading; its checksum is verified at the end."""
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
        except RuntimeError as error:  # also for an unsupported method
            raise StoreError(
                f"{self}: can't be unpacked ({error}); unpack {self._file} with the program that "
                "made it, or make it again without a password, uncompressed or deflated"
            ) from error
        except _DAMAGE as error:
            raise IntegrityError(f"{self}: damaged ({error}); fetch {self._file} again") from error
