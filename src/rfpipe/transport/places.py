"""Finding the transport in what a user names: a store, a run's folder, a zip file, an address."""

from __future__ import annotations

from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store.chunks import METADATA
from rfpipe.store.locating import locate, within_packed, zip_at
from rfpipe.store.places import Place

__all__ = ["MANIFEST", "STORE_NAME", "ZIP_NAME", "find_transport", "transports_in"]

STORE_NAME = "transport.zarr"
"""Under which an acquisition's transport is stored."""

ZIP_NAME = "transport.zip"
"""Under which `rfpipe keep` brings it into a bucket, as one object."""

MANIFEST = "manifest-sha256.txt"
"""Of a publication: the SHA-256 and the name of every file, a line each."""


def find_transport(path: str | Path) -> Path | Place:
    """Return where the one transport lies that `path` names or holds.

    Raises
    ------
    StoreError
        If there is none, or more than one.
    """
    return _transport_at(locate(path))


def _transport_at(place: Path | Place) -> Path | Place:
    if isinstance(place, Path) and not place.is_dir():
        what = "a file, no store" if place.exists() else "no such file or folder"
        raise StoreError(
            f"{place}: {what}; give the {STORE_NAME} that an acquisition wrote, or a folder, zip "
            "file or address that has one. A matrix in a file is read by rfpipe.read_matrix"
        )
    if _is_store(place):
        return place
    place = within_packed(place) or place
    if _is_store(place):
        return place
    names = transports_in(place)
    if len(names) == 1:
        found = place / names[0]
        if isinstance(found, Path) or not names[0].endswith(ZIP_NAME):
            return found
        return _transport_at(zip_at(found))
    if not names:
        raise StoreError(
            f"{place}: no {STORE_NAME} in here; give the {STORE_NAME} that an acquisition wrote, "
            "or a folder, zip file or address that has one"
        )
    listed = "\n".join(f"  {place}/{name}" for name in names)
    raise StoreError(f"{place}: has {len(names)} transports; name one of\n{listed}")


def _is_store(place: Path | Place) -> bool:
    """Whether a place is to be opened as it is."""
    if isinstance(place, Path):
        return (place / METADATA).exists()
    if place.key:
        return place.key.endswith(".zarr")
    return bool(place.read_many([METADATA]))  # a zip file of a store alone


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
    listed = place.read_many([MANIFEST]).get(MANIFEST)
    if listed is None:
        files = place.files()
    else:
        files = [line[66:] for line in listed.decode(errors="replace").splitlines()]
    ends = (f"{STORE_NAME}/{METADATA}", ZIP_NAME)
    stores = [name for name in files if f"/{name}".endswith(tuple(f"/{end}" for end in ends))]
    return sorted(name.removesuffix(f"/{METADATA}") for name in stores)
