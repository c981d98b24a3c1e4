"""Checking files against a list of their SHA-256, in a folder, a zip or behind an address."""

from __future__ import annotations

import hashlib
import lzma
import re
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import IO
from urllib.parse import unquote

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.stages.checking.stores import RESTORE, Checked, check_arrays_afar
from rfpipe.store.places import METADATA, Place, content_of, locate
from rfpipe.transport.storage import ZIP_NAME, transports_in

LIST = "manifest-sha256.txt"
"""A line a file: 64 hexadecimal digits, spaces, its path; as BagIt (RFC 8493) has it."""

_TAGS = "tagmanifest-sha256.txt"
_LINE = re.compile(r"([0-9a-fA-F]{64})[ \t]+[*]?(.+)")
_BLOCK = 2**20
# What `zipfile` raises on damaged bytes.
_DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError)


def check_place(place: Path | Place, checked: Checked) -> bool:
    """Check a folder with a list of its files; of a `Place`, a transport or transports, too.

    Returns
    -------
    bool
        False for a folder on the disk without a list.

    Raises
    ------
    InputError
        When a zip file or an address has neither.
    StoreError
        When a server doesn't answer.
    """
    if isinstance(place, Path):
        if not (place / LIST).is_file():
            return False
        names = {file.relative_to(place).as_posix() for file in place.rglob("*") if file.is_file()}
        _check_list(place, names, checked)
        return True
    root, names = _names(place)
    if LIST in names:
        _check_list(root, names, checked)
        return True
    is_store = content_of(place / METADATA) is not None
    stores = [place] if is_store else [place / name for name in transports_in(place)]
    if not stores:
        raise InputError(
            f"{place}: has no {LIST} and no transport; expected what 'rfpipe keep' or 'rfpipe "
            "publish' made, or a transport"
        )
    for store in stores:
        if store.key.endswith(ZIP_NAME):
            check_place(locate(store), checked)
        else:
            check_arrays_afar(store, checked)
    return True


def _names(place: Place) -> tuple[Place, set[str]]:
    """Return the folder that has a list, the place or one in it, and its files; none without one.

    A web server doesn't list its files: those are returned that the list names.
    """
    listed = content_of(place / LIST)
    if listed is not None:
        try:
            return place, set(place.files())
        except StoreError:
            return place, {LIST, *_lines(listed)[0]}
    if not place.key:  # a zip file of a single folder
        try:
            names = place.files()
        except StoreError:
            return place, set()
        lists = [name for name in names if PurePosixPath(name).name == LIST]
        folder = min(lists, key=lambda name: name.count("/"), default="").removesuffix(LIST)
        if folder:
            inside = {name.removeprefix(folder) for name in names if name.startswith(folder)}
            return place / folder, inside
    return place, set()


def _lines(content: bytes) -> tuple[dict[str, str], list[int]]:
    """Return the digests of a list by path, and the numbers of the lines that are none."""
    digests, strange = {}, []
    for number, line in enumerate(content.decode("utf-8-sig", "replace").splitlines(), 1):
        if entry := _LINE.fullmatch(line.strip()):
            digests[unquote(entry[2]).removeprefix("./")] = entry[1].lower()
        elif line.strip():
            strange.append(number)
    return digests, strange


def _check_list(root: Path | Place, names: set[str], checked: Checked) -> None:
    """Check each file of the list, and note which files it lacks.

    In a bag the payload lies in ``data``; a plain list names all files.
    """
    listed: dict[str, str] = {}
    for name in {LIST, _TAGS} & names:
        with _opened(root, name) as file:
            digests, strange = _lines(file.read())
        listed |= digests
        for number in strange:
            checked.wrong(root / name, f"line {number} is no SHA-256 and path", RESTORE)
    for name, digest in listed.items():
        path = root / name
        checked.files += 1
        try:
            if name not in names:
                raise FileNotFoundError
            if _sha256(root, name, checked) != digest:
                checked.wrong(path, "is altered: its SHA-256 isn't that of the list", RESTORE)
        except FileNotFoundError:
            checked.wrong(path, "is missing", RESTORE)
        except (IntegrityError, *_DAMAGE) as error:
            checked.wrong(path, f"can't be read: {error}", RESTORE)
    is_bag = "bagit.txt" in names
    for name in sorted(names - listed.keys() - {LIST, _TAGS}):
        if not is_bag or name.startswith("data/"):
            checked.notes.append(f"{root / name}: isn't in the list of files")


def _opened(root: Path | Place, name: str) -> IO[bytes]:
    return (root / name).open() if isinstance(root, Place) else (root / name).open("rb")


def _sha256(root: Path | Place, name: str, checked: Checked) -> str:
    digest = hashlib.sha256()
    with _opened(root, name) as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            checked.read(len(block))
    return digest.hexdigest()
