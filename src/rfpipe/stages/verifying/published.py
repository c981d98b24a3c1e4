"""Checking a folder or zip that was published with a list of its files and their SHA-256."""

from __future__ import annotations

import hashlib
import lzma
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path, PurePosixPath
from typing import IO, Protocol
from urllib.parse import unquote

from rfpipe.errors import IntegrityError
from rfpipe.stages.verifying.findings import Checked, Mend
from rfpipe.store.files import storage_errors
from rfpipe.store.places import Place

__all__ = ["LIST", "check_list", "listed_names", "published"]

LIST = "manifest-sha256.txt"
"""A line a file: 64 hexadecimal digits, spaces, its path; as BagIt (RFC 8493) has it."""

_TAGS = "tagmanifest-sha256.txt"
_LINE = re.compile(r"([0-9a-fA-F]{64})[ \t]+[*]?(.+)")
_BLOCK = 2**20
_COPY = Mend("restore")
# What `zipfile` raises on damaged bytes.
_DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError)


class Files(Protocol):
    """The files that were published, by their paths."""

    @property
    def path(self) -> Path | Place:
        """Where they lie."""

    @property
    def names(self) -> set[str]:
        """Of all files."""

    def open(self, name: str) -> IO[bytes]:
        """Open one for reading."""


class _Folder:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.names = {
            file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file()
        }

    def open(self, name: str) -> IO[bytes]:
        return (self.path / name).open("rb")


class _Zip:
    """The files of a zip; of one with a single folder at its root, those in it."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self.path = path
        self._archive = archive
        names = [name for name in archive.namelist() if not name.endswith("/")]
        lists = [name for name in names if PurePosixPath(name).name == LIST]
        nearest = min(lists, key=lambda name: name.count("/"), default="")
        self._root = nearest.removesuffix(LIST)
        self.names = {
            name.removeprefix(self._root) for name in names if name.startswith(self._root)
        }

    def open(self, name: str) -> IO[bytes]:
        return self._archive.open(self._root + name)


@contextmanager
def published(path: Path) -> Iterator[Files | None]:
    """Provide the files of a published folder or zip, None where it has no list of them."""
    if path.is_dir():
        yield _Folder(path) if (path / LIST).is_file() else None
    elif zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            files = _Zip(path, archive)
            yield files if LIST in files.names else None
    else:
        yield None


def check_list(files: Files, checked: Checked) -> None:
    """Check each file of a list, and say which files it lacks.

    Beside BagIt's own, whose payload lies in ``data``, a plain list of all files will do.
    """
    listed = _read(files, LIST, checked)
    tags = _read(files, _TAGS, checked) if _TAGS in files.names else {}
    for name, digest in {**listed, **tags}.items():
        path = files.path / name
        checked.files += 1
        if name not in files.names:
            checked.wrong(path, "is missing", _COPY)
            continue
        try:
            if _sha256(files, name, checked) != digest:
                checked.wrong(path, "is altered: its SHA-256 isn't that of the list", _COPY)
        except FileNotFoundError:  # of a web server, which doesn't tell what it has
            checked.wrong(path, "is missing", _COPY)
        except (IntegrityError, *_DAMAGE) as error:
            checked.wrong(path, f"can't be read: {error}", _COPY)
    is_bag = "bagit.txt" in files.names
    for name in sorted(files.names - listed.keys() - tags.keys() - {LIST, _TAGS}):
        if not is_bag or name.startswith("data/"):
            checked.notes.append(f"{files.path / name}: isn't in the list of files")


def listed_names(content: bytes) -> list[str]:
    """Return the paths that a list names."""
    lines = content.decode("utf-8-sig", errors="replace").splitlines()
    found = (_LINE.fullmatch(line.strip()) for line in lines)
    return [_path_in(line) for line in found if line]


def _path_in(line: re.Match[str]) -> str:
    return unquote(line[2]).removeprefix("./")


def _read(files: Files, name: str, checked: Checked) -> dict[str, str]:
    """Return digest by path of a list; lines that are none are found."""
    listed = {}
    with _opened(files, name) as file:
        text = file.read().decode("utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        found = _LINE.fullmatch(line.strip())
        if found:
            listed[_path_in(found)] = found[1].lower()
        elif line.strip():
            checked.wrong(files.path / name, f"line {number} is no SHA-256 and path", _COPY)
    return listed


@contextmanager
def _opened(files: Files, name: str) -> Iterator[IO[bytes]]:
    where = files.path
    errors = storage_errors(where / name, "reading") if isinstance(where, Path) else nullcontext()
    with errors, files.open(name) as file:
        yield file


def _sha256(files: Files, name: str, checked: Checked) -> str:
    digest = hashlib.sha256()
    with _opened(files, name) as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            checked.read(len(block))
    return digest.hexdigest()
