"""A matrix as a MAT file of version 7.3, which is HDF5 behind a header of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.files.contents import ABOUT, Contents
from rfpipe.transport.files.hdf5 import COMPRESSED, chunk, new_file
from rfpipe.version import __version__

if TYPE_CHECKING:
    import h5py

__all__ = ["write_matlab"]

_HEADER_BYTES = 512
_TEXT_BYTES = 116
_OF_MATLAB = (
    "In MATLAB T is (row, column, channel), rays count from 0 in 'rows' and 'columns', and the "
    "image of c = T(:, :, 1) * p is reshape(c, camera_shape(end:-1:1))'."
)


def write_matlab(path: Path, contents: Contents) -> None:
    """Write the variables ``T`` (rows, columns, channels), what stands beside it, and ``about``.

    MATLAB counts axes from the other end than HDF5, so the dataset is (C, columns, rows).
    """
    with new_file(path, userblock_size=_HEADER_BYTES) as file:
        channels, rows, columns = contents.shape
        shape = (channels, columns, rows) if channels > 1 else (columns, rows)
        high, wide = chunk(rows, columns)
        chunks = (1, wide, high) if channels > 1 else (wide, high)
        matrix = file.create_dataset("T", shape, "<f4", chunks=chunks, **COMPRESSED)
        matrix.attrs["MATLAB_class"] = np.bytes_("single")
        for of_rows, of_columns, block in contents.blocks(by_rows=rows <= columns):
            part = block.swapaxes(1, 2)
            matrix[..., of_columns, of_rows] = part if channels > 1 else part[0]
        for name, array in contents.arrays().items():
            _variable(file, name, array[:, None].astype("<f8"), "double")
        text = np.frombuffer(f"{ABOUT} {_OF_MATLAB}".encode("utf-16-le"), "<u2")
        _variable(file, "about", text[:, None], "char", MATLAB_int_decode=np.int32(2))
    _write_header(path)


def _variable(
    file: h5py.File, name: str, array: NDArray[Any], kind: str, **attributes: Any
) -> None:
    """Write a variable, its axes reversed."""
    dataset = file.create_dataset(name, data=array)
    for attribute, value in {"MATLAB_class": np.bytes_(kind), **attributes}.items():
        dataset.attrs[attribute] = value


def _write_header(path: Path) -> None:
    """Fill the block before the HDF5 part by which MATLAB knows the version."""
    text = f"MATLAB 7.3 MAT-file, Platform: rfpipe {__version__}, HDF5 schema 1.00 ."
    header = text.encode()[:_TEXT_BYTES].ljust(_TEXT_BYTES)
    header += bytes(8) + b"\x00\x02" + b"IM"  # no subsystem; version 2.0; little-endian
    with path.open("r+b") as file:
        file.write(header.ljust(_HEADER_BYTES, b"\0"))
