"""Finding out where something lies: on a disk, inside of a zip file, or behind an address."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import IO

from rfpipe.errors import StoreError
from rfpipe.store.packed import INDEX, packed_in
from rfpipe.store.places import Place, ZipPlace

__all__ = ["as_address", "locate"]

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
        from rfpipe.store.remote import ObjectPlace, connect, open_ranged

        found = _ZIP.match(address)
        if found is None:
            return ObjectPlace(*connect(address))
        store, key, root = connect(found[1])
        name = f"{root}/{key}"
        return _in_zip(open_ranged(store, key, name), name, address[found.end() :])
    for outer in (Path(path), *Path(path).parents):
        if outer.suffix.lower() == ".zip" and outer.is_file():
            return _in_zip(outer, str(outer), Path(path).relative_to(outer).as_posix())
        packed = packed_in(outer) if (outer / INDEX).is_file() else None
        if packed is not None and outer != Path(path):
            return packed / Path(path).relative_to(outer).as_posix()
    return Path(path)


def _in_zip(file: Path | IO[bytes], name: str, key: str) -> ZipPlace:
    try:
        archive = zipfile.ZipFile(file)
    except (zipfile.BadZipFile, OSError) as error:
        raise StoreError(
            f"{name}: can't be read as a zip file ({error}); is it whole? Fetch it anew"
        ) from error
    return ZipPlace(archive, name, "" if key == "." else key)
