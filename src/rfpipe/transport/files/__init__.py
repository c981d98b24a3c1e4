"""The matrix of a transport in files that other programs read."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from pathlib import Path

from rfpipe.errors import InputError, StoreError
from rfpipe.store.files import free_bytes, storage_errors, whole_file
from rfpipe.transport.algebra import MatrixAlgebra, Rays, chosen_rays, gibibytes
from rfpipe.transport.files.contents import Contents
from rfpipe.transport.files.hdf5 import write_hdf5
from rfpipe.transport.files.matlab import write_matlab
from rfpipe.transport.files.npz import write_npz

__all__ = ["MATRIX_FILES", "write_matrix"]

MATRIX_FILES: dict[str, Callable[[Path, Contents], None]] = {
    ".npz": write_npz,
    ".h5": write_hdf5,
    ".hdf5": write_hdf5,
    ".mat": write_matlab,
}
"""What writes a matrix, by the end of a file's name."""


def write_matrix(
    matrix: MatrixAlgebra,
    path: Path,
    rows: Rays,
    columns: Rays,
    limit_bytes: int,
    *,
    progress: bool = False,
) -> None:
    """Write a matrix, see `rfpipe.transport.base.Light.save`; show how far it is if asked to."""
    write = MATRIX_FILES.get(path.suffix.lower())
    if write is None:
        raise InputError(
            f"{path}: ends in {path.suffix!r}; a matrix is written to {', '.join(MATRIX_FILES)}, a "
            "transport as it is to .zarr"
        )
    contents = Contents(
        matrix,
        chosen_rays(rows, matrix.camera_shape, "rows"),
        chosen_rays(columns, matrix.projector_shape, "columns"),
        progress=progress,
    )
    if contents.nbytes > limit_bytes:
        entries = " x ".join(f"{length:,}" for length in contents.shape)
        raise InputError(
            f"{path}: a matrix of {entries} = {prod(contents.shape):,} entries takes "
            f"{gibibytes(contents.nbytes)}, the limit is {gibibytes(limit_bytes)}; choose rows or "
            "columns, lower the scale (at half of it the matrix is 16 times smaller), or raise "
            "the limit"
        )
    if contents.nbytes > free_bytes(path.absolute().parent):
        raise StoreError(
            f"{path}: up to {contents.nbytes:,} bytes needed, "
            f"{free_bytes(path.absolute().parent):,} bytes free on its file system; make room, or "
            "choose rows or columns"
        )
    with (
        storage_errors(path, "writing", contents.nbytes, resumes=False),
        whole_file(path) as partial,
    ):
        write(partial, contents)
