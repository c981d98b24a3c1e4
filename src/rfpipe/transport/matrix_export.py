"""Export of a transport's matrix to files of NumPy, HDF5 and MATLAB."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float, Index
from rfpipe.errors import StoreError
from rfpipe.installation import needing
from rfpipe.output import Sink, suffix_of, whole_file
from rfpipe.transport.algebra import (
    BATCH_MULTIPLE,
    MatrixAlgebra,
    RaySelection,
    check_size,
    selected_rays,
)
from rfpipe.version import __version__

ABOUT = (
    "Light transport T by rfpipe: T[channel, row, column] is the radiance that a camera ray (row) "
    "receives when the projector ray (column) has the weight 1. c = T p. Rays are numbered row by "
    "row of their images, from 0: camera_shape and projector_shape are (height, width), views "
    "before them. 'rows' and 'columns' are the rays that are kept."
)
"""Description in each file."""

_ABOUT_MATLAB = (
    "In MATLAB T is (row, column, channel), rays count from 0 in 'rows' and 'columns', and the "
    "image of c = T(:, :, 1) * p is reshape(c, camera_shape(end:-1:1))'."
)
_CHUNK_ENTRIES = 2**18
_MATLAB_HEADER, _MATLAB_TEXT = 512, 116
# Compression that every HDF5 library can read.
_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


class Contents(NamedTuple):
    """Selected rows and columns of a matrix, by the numbers of their rays."""

    matrix: MatrixAlgebra
    rows: Index
    columns: Index

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows, columns."""
        return self.matrix.channels, len(self.rows), len(self.columns)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the small arrays that describe T: shapes and numbers of rays."""
        shapes = {"camera_shape": self.matrix.camera_shape}
        shapes["projector_shape"] = self.matrix.projector_shape
        arrays = {name: np.array(shape, np.int64) for name, shape in shapes.items()}
        return {**arrays, "rows": self.rows, "columns": self.columns}

    def blocks(
        self, *, by_rows: bool, channels: Sequence[int] | None = None
    ) -> Iterator[tuple[slice, slice, Float]]:
        """Yield T in parts; see `rfpipe.transport.algebra.MatrixAlgebra.blocks`."""
        return self.matrix.blocks(self.rows, self.columns, by_rows=by_rows, channels=channels)


def write_matrix(
    matrix: MatrixAlgebra, path: Path, rows: RaySelection, columns: RaySelection, limit_bytes: int
) -> None:
    """Write a matrix, see `rfpipe.transport.relightable.Relightable.save`."""
    write = MATRIX_FILES[suffix_of(path, tuple(MATRIX_FILES))]
    contents = Contents(
        matrix,
        selected_rays(rows, matrix.camera_shape, "rows"),
        selected_rays(columns, matrix.projector_shape, "columns"),
    )
    advice = "choose rows or columns, join rays (2 x 2: 16 times smaller), or raise the limit"
    check_size(f"{path}: a matrix", contents.shape, limit_bytes, advice)
    nbytes = 4 * prod(contents.shape)
    with whole_file(path, nbytes) as partial:
        write(partial, contents)


def _write_npz(path: Path, contents: Contents) -> None:
    """Write ``T`` (C, rows, columns), the arrays that describe it, and the text ``about``."""
    small = {**contents.arrays(), "about": np.array(ABOUT)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in small.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
        with archive.open("T.npy", "w", force_zip64=True) as member:
            header = {"descr": "<f4", "fortran_order": False, "shape": contents.shape}
            np.lib.format.write_array_header_2_0(member, header)
            for block in _rows_by_channel(contents):
                member.write(np.ascontiguousarray(block, "<f4").data)


def _rows_by_channel(contents: Contents) -> Iterator[Float]:
    """Yield rows of T, (rows, columns), one channel after the other."""
    for channel in range(contents.shape[0]):
        for *_, block in contents.blocks(by_rows=True, channels=[channel]):
            yield block[0]


def _write_hdf5(path: Path, contents: Contents) -> None:
    """Write the dataset ``T``, the arrays that describe it, and texts.

    A MAT file of version 7.3 is HDF5 after a header of 512 bytes, with the axes in reverse order.
    """
    with needing("export", f"writing {path.suffix}", StoreError):
        import h5py
    matlab = path.suffix.lower() == ".mat"
    with path.open("w+b", buffering=0) as file:
        sink = Sink(file)
        try:
            with h5py.File(sink, "w", userblock_size=_MATLAB_HEADER if matlab else 0) as hdf5:
                _fill(hdf5, contents, sink, matlab=matlab)
            if matlab:
                sink.seek(0)
                sink.write(_matlab_header())
        finally:
            sink.raise_failure()


def _fill(file: Any, contents: Contents, sink: Sink, *, matlab: bool) -> None:
    """Write the datasets of an HDF5 file; OSError when the disk is full."""
    channels, rows, columns = contents.shape
    by_rows = rows <= columns
    # parts are whole rows or columns, and each chunk is in one part
    short, long = BATCH_MULTIPLE, _CHUNK_ENTRIES // BATCH_MULTIPLE
    chunk = (1, min(rows, short if by_rows else long), min(columns, long if by_rows else short))
    order = [0, 1, 2]
    if matlab:  # drops an axis of one channel
        order = [0, 2, 1] if channels > 1 else [2, 1]
    shape, chunks = (tuple(lengths[axis] for axis in order) for lengths in (contents.shape, chunk))
    matrix = file.create_dataset("T", shape, "<f4", chunks=chunks, **_COMPRESSION)
    for row_range, column_range, block in contents.blocks(by_rows=by_rows):
        ranges = slice(None), row_range, column_range
        transposed = block.transpose(order) if len(order) == len(ranges) else block[0].T
        matrix[tuple(ranges[axis] for axis in order)] = transposed
        sink.raise_failure()
    if matlab:
        matrix.attrs["MATLAB_class"] = np.bytes_("single")
        for name, array in contents.arrays().items():
            file[name] = array[:, None].astype("<f8")
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        text = np.frombuffer(f"{ABOUT} {_ABOUT_MATLAB}".encode("utf-16-le"), "<u2")
        file["about"] = text[:, None]
        file["about"].attrs["MATLAB_class"] = np.bytes_("char")
        file["about"].attrs["MATLAB_int_decode"] = np.int32(2)
    else:
        matrix.attrs["unit"] = "radiance per weight"
        matrix.attrs["axes"] = "channel, camera ray, projector ray"
        file.attrs["about"], file.attrs["rfpipe"] = ABOUT, __version__
        for name, array in contents.arrays().items():
            file[name] = array


def _matlab_header() -> bytes:
    """Return the header before the HDF5 part, from which MATLAB reads the version."""
    text = f"MATLAB 7.3 MAT-file, Platform: rfpipe {__version__}, HDF5 schema 1.00 ."
    header = text.encode()[:_MATLAB_TEXT].ljust(_MATLAB_TEXT)
    header += bytes(8) + b"\x00\x02" + b"IM"  # no subsystem; version 2.0; little-endian
    return header.ljust(_MATLAB_HEADER, b"\0")


MATRIX_FILES = {".npz": _write_npz, ".h5": _write_hdf5, ".hdf5": _write_hdf5, ".mat": _write_hdf5}
"""Functions that write a matrix, by the suffix of the file."""
