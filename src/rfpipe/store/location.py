"""Open what a path or address names: on disk, in a zip file, in a packed folder, on a server."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from rfpipe.store.places import METADATA, Place, as_address, readable_content

_ZIP = re.compile(r"^(.*?\.zip)(?:/+|$)", re.IGNORECASE)


def locate(path: str | Path | Place) -> Path | Place:
    """Return a path on disk, or the place in a zip file, a packed folder or on a server.

    Parameters
    ----------
    path
        A path; ``crate.zip`` or ``crate.zip/folder/inside``; a folder that ``rfpipe collection
        pack`` made; an address of any of these, ``http(s)://host/...`` or ``s3://bucket/...``; or
        the place of a zip file.

    Raises
    ------
    StoreError
        When a zip file or a packed folder is damaged, or a server doesn't answer.
    InputError
        When the address has another scheme.
    """
    if isinstance(path, Place):
        return _in_zip(path) if path.key.lower().endswith(".zip") else path
    if (Path(path) / METADATA).is_file():
        return Path(path)
    address = as_address(path)
    return _on_disk(Path(path)) if address is None else _on_server(address)


def _on_server(address: str) -> Place:
    from rfpipe.store.addresses import ObjectPlace

    match = _ZIP.match(address)
    if match is None:
        return _within_packed(ObjectPlace.of(address))
    return _in_zip(ObjectPlace.of(match[1]), address[match.end() :])


def _on_disk(path: Path) -> Path | Place:
    from rfpipe.store.packed import packed_in

    for outer in (path, *path.parents):
        inside = "/".join(path.relative_to(outer).parts)
        if outer.suffix.lower() == ".zip" and outer.is_file():
            return _in_zip(outer, inside)
        packed = packed_in(outer)
        if packed is not None:
            return packed.at(inside)
    return path


def _in_zip(file: Path | Place, key: str = "") -> Place:
    from rfpipe.store.zip_files import open_zip

    return _within_packed(open_zip(file, key))


def _within_packed(place: Place) -> Place:
    """Return the place itself, or its content in a packed folder around it.

    Packed folders are searched only where the place has no Zarr metadata: each costs a request.
    """
    from rfpipe.store.packed import packed_in

    if readable_content(place / METADATA) is not None:
        return place
    parts = PurePosixPath(place.key).parts
    for n in range(len(parts), -1, -1):
        packed = packed_in(place.at("/".join(parts[:n])))
        if packed is not None:
            return packed.at("/".join(parts[n:]))
    return place
