"""A matrix as HDF5."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.errors import StoreError, installing
from rfpipe.transport.algebra import AT_A_TIME
from rfpipe.transport.files.contents import ABOUT, Contents
from rfpipe.version import __version__

if TYPE_CHECKING:
    import h5py

__all__ = ["COMPRESSED", "chunk", "new_file", "write_hdf5"]

COMPRESSED: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
"""How T is kept: as every HDF5 library can read."""

_CHUNK_ENTRIES = 2**18


def write_hdf5(path: Path, contents: Contents) -> None:
    """Write the dataset ``T`` (C, rows, columns), what stands beside it, and attributes."""
    with new_file(path) as file:
        file.attrs["about"] = ABOUT
        file.attrs["rfpipe"] = __version__
        for name, array in contents.arrays().items():
            file[name] = array
        _, rows, columns = contents.shape
        chunks = (1, *chunk(rows, columns))
        matrix = file.create_dataset("T", contents.shape, "<f4", chunks=chunks, **COMPRESSED)
        matrix.attrs["unit"] = "radiance per weight"
        matrix.attrs["axes"] = "channel, camera ray, projector ray"
        for of_rows, of_columns, block in contents.blocks(by_rows=rows <= columns):
            matrix[:, of_rows, of_columns] = block


@contextmanager
def new_file(path: Path, **options: Any) -> Iterator[h5py.File]:
    """Make an HDF5 file.

    Raises
    ------
    StoreError
        If h5py isn't installed, or the file can't be written.
    """
    try:
        import h5py
    except ImportError as error:
        raise StoreError(
            f"HDF5 and MAT files are written by h5py, which can't be loaded: {error}. Write an "
            f".npz, or {installing('export')}"
        ) from error
    with h5py.File(path, "w", **options) as file:
        yield file


def chunk(rows: int, columns: int) -> tuple[int, int]:
    """Return the shape of the chunks of a matrix, each of which is written once, by one part."""
    if rows <= columns:  # the parts are whole rows
        return min(rows, AT_A_TIME), min(columns, _CHUNK_ENTRIES // AT_A_TIME)
    return min(rows, _CHUNK_ENTRIES // AT_A_TIME), min(columns, AT_A_TIME)
