"""Finding out where something lies: on a disk, inside of a zip file, or behind an address."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import IO

from rfpipe.errors import IntegrityError, StoreError, UnreachableError
from rfpipe.store.packed import INDEX, packed_in
from rfpipe.store.places import ZIP_DAMAGE, Place, ZipPlace

__all__ = ["as_address", "locate", "within_packed", "zip_at"]

_ADDRESS = re.compile(r"^([A-Za-z][A-Za-z0-9+]+):/+(?=[^/])")
_ZIP = re.compile(r"^(.*?\.zip)(?:/+|$)", re.IGNORECASE)


def as_address(path: str | Path) -> str | None:
    """Return an address such as ``https://host/run`` as text, None for a path on this machine.

    A `Path` made of an address has lost one of its slashes; it counts as well.
    """
    found = _ADDRESS.match(str(path))
    return None if found is None else _ADDRESS.sub(r"\1://", str(path))


def locate(path: str | Path) -> Path | Place:
    """Find out where something lies: a path here, inside of a zip file, or behind an address.

    Parameters
    ----------
    path
        A path; ``crate.zip`` or ``crate.zip/folder/inside``; or an address of either,
        ``http(s)://host/...`` or ``s3://bucket/...``.

    Raises
    ------
    StoreError
        When a zip file or a packed folder is damaged, or a server doesn't answer.
    """
    address = as_address(path)
    if address is not None:
        from rfpipe.store.remote import ObjectPlace, connect

        found = _ZIP.match(address)
        if found is None:
            return ObjectPlace(*connect(address))
        return zip_at(ObjectPlace(*connect(found[1])), address[found.end() :])
    for outer in (Path(path), *Path(path).parents):
        if outer.suffix.lower() == ".zip" and outer.is_file():
            return _in_zip(outer, str(outer), Path(path).relative_to(outer).as_posix())
        packed = packed_in(outer) if (outer / INDEX).is_file() else None
        if packed is not None and outer != Path(path):
            return packed / Path(path).relative_to(outer).as_posix()
    return Path(path)


def within_packed(place: Path | Place) -> Place | None:
    """Find the packed folder that a place lies in, or is, and the place in it; None without one.

    Behind an address that takes a request for each folder above, so that it is asked last.

    Raises
    ------
    IntegrityError
        When the folder's index is damaged.
    UnreachableError
        When the server doesn't answer.
    """
    if isinstance(place, Path):
        return packed_in(place)
    outer, inside = place, ""
    while True:
        try:
            packed = packed_in(outer)
        except (IntegrityError, UnreachableError):
            raise
        except StoreError:  # a bucket that doesn't tell what it lacks
            packed = None
        if packed is not None:
            return packed / inside
        if not outer.key:
            return None
        above, _, name = outer.key.rpartition("/")
        inside = f"{name}/{inside}".rstrip("/")
        outer = outer.at(above)


def zip_at(place: Place, key: str = "") -> ZipPlace:
    """Open a zip file that isn't on the disk, at a place in it.

    Raises
    ------
    StoreError
        When there is none, or it is damaged.
    """
    try:
        file = place.open()
    except FileNotFoundError:
        raise StoreError(f"{place}: no such file; check the address") from None
    return _in_zip(file, str(place), key)


def _in_zip(file: Path | IO[bytes], name: str, key: str) -> ZipPlace:
    try:
        archive = zipfile.ZipFile(file)
    except ZIP_DAMAGE as error:
        raise StoreError(
            f"{name}: can't be read as a zip file ({error}); is it whole? Fetch it anew"
        ) from error
    return ZipPlace(archive, name, "" if key == "." else key)
