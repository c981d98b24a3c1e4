"""Finding the transport in what a user names: a store, a run's folder, a zip file, an address."""

from __future__ import annotations

from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store.places import METADATA, Place, content_of, locate

STORE_NAME = "transport.zarr"
"""Under which an acquisition's transport is stored."""

ZIP_NAME = "transport.zip"
"""Under which `rfpipe keep` brings it into a bucket, as one object."""

MANIFEST = "manifest-sha256.txt"
"""Of a publication: the SHA-256 and the name of every file, a line each."""


def find_transport(path: str | Path | Place) -> Path | Place:
    """Return where the one transport lies that `path` names or holds.

    Raises
    ------
    StoreError
        If there is none, or more than one.
    """
    place = locate(path)
    if isinstance(place, Path) and not place.is_dir():
        what = "a file, no store" if place.exists() else "no such file or folder"
        raise StoreError(
            f"{place}: {what}; give the {STORE_NAME} that an acquisition wrote, or a folder, zip "
            "file or address that has one. A matrix in a file is read by rfpipe.read_matrix"
        )
    is_named = isinstance(place, Place) and place.key.endswith(".zarr")
    if is_named or content_of(place / METADATA) is not None:
        return place
    names = transports_in(place)
    if len(names) == 1:
        found = place / names[0]
        return find_transport(found) if names[0].endswith(ZIP_NAME) else found
    if not names:
        raise StoreError(
            f"{place}: no {STORE_NAME} in here; give the {STORE_NAME} that an acquisition wrote, "
            "or a folder, zip file or address that has one"
        )
    listed = "\n".join(f"  {place}/{name}" for name in names)
    raise StoreError(f"{place}: has {len(names)} transports; name one of\n{listed}")


def transports_in(place: Path | Place) -> list[str]:
    """Return the names, relative to a folder, of the transports below it.

    Raises
    ------
    StoreError
        When its files can't be listed.
    """
    if isinstance(place, Path):
        found = place.rglob(f"{STORE_NAME}/{METADATA}")
        return sorted(file.parent.relative_to(place).as_posix() for file in found)
    listed = content_of(place / MANIFEST)
    if listed is None:
        files = place.files()
    else:
        files = [line[66:] for line in listed.decode(errors="replace").splitlines()]
    ends = (f"/{STORE_NAME}/{METADATA}", f"/{ZIP_NAME}")
    return sorted(name.removesuffix(f"/{METADATA}") for name in files if f"/{name}".endswith(ends))
