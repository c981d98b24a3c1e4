"""Checking a folder that was published with a list of its files and their SHA-256."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from urllib.parse import unquote

from rfpipe.stages.verifying.findings import Checked, Mend
from rfpipe.store.files import storage_errors

__all__ = ["LIST", "check_list", "is_listed"]

LIST = "manifest-sha256.txt"
"""A line a file: 64 hexadecimal digits, spaces, its path; as BagIt (RFC 8493) has it."""

_TAGS = "tagmanifest-sha256.txt"
_LINE = re.compile(r"([0-9a-fA-F]{64})[ \t]+[*]?(.+)")
_BLOCK = 2**20
_COPY = Mend("restore")


def is_listed(folder: Path) -> bool:
    """Whether a folder has a list of its files."""
    return (folder / LIST).is_file()


def check_list(folder: Path, checked: Checked) -> None:
    """Check each file of a published folder's list, and that there are no others.

    Beside BagIt's own, whose payload lies in ``data``, a plain list of all files will do.
    """
    listed = _read(folder, LIST, checked)
    tags = _read(folder, _TAGS, checked) if (folder / _TAGS).is_file() else {}
    for name, digest in {**listed, **tags}.items():
        path = folder / name
        checked.files += 1
        if not path.resolve().is_relative_to(folder.resolve()):
            checked.wrong(folder / LIST, f"names a file outside of the folder: {name}", _COPY)
        elif not path.is_file():
            checked.wrong(path, "is missing", _COPY)
        elif _sha256(path, checked) != digest:
            checked.wrong(path, "is altered: its SHA-256 isn't that of the list", _COPY)
    payload = folder / "data" if (folder / "bagit.txt").is_file() else folder
    own = {LIST, _TAGS}
    for path in sorted(payload.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in listed and name not in tags and name not in own:
            checked.notes.append(f"{path}: isn't in the list of files")


def _read(folder: Path, name: str, checked: Checked) -> dict[str, str]:
    """Return digest by path of a list; lines that are none are found."""
    listed = {}
    with storage_errors(folder / name, "reading"):
        text = (folder / name).read_text(encoding="utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        found = _LINE.fullmatch(line.strip())
        if found:
            listed[unquote(found[2]).removeprefix("./")] = found[1].lower()
        elif line.strip():
            checked.wrong(folder / name, f"line {number} is no SHA-256 and path", _COPY)
    return listed


def _sha256(path: Path, checked: Checked) -> str:
    digest = hashlib.sha256()
    with storage_errors(path, "reading"), path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            checked.read(len(block))
    return digest.hexdigest()
