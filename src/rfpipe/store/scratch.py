"""Arrays in temporary files, for data that are too large for memory."""

from __future__ import annotations

import tempfile
from functools import cached_property
from math import prod
from pathlib import Path
from typing import IO, Any, Self
from weakref import finalize

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rfpipe.output import storage_errors


class ScratchArray:
    """Array in a temporary file, of which parts are read; it grows along its first axis.

    The file is in the folder for temporary files, `tempfile.gettempdir`. It has no name: the system
    deletes it when the array is deleted or the process ends, even by ``kill -9``.

    Parameters
    ----------
    dtype : dtype
    row_shape : tuple of int
        Lengths of all axes but the first.
    """

    def __init__(self, dtype: DTypeLike, row_shape: tuple[int, ...] = ()) -> None:
        self.dtype, self.shape = np.dtype(dtype), (0, *row_shape)

    @classmethod
    def of(cls, array: NDArray[Any]) -> Self:
        """Store a copy of an array."""
        stored = cls(array.dtype, array.shape[1:])
        stored.append(array)
        return stored

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def nbytes(self) -> int:
        """Size of the array in bytes."""
        return prod(self.shape) * self.dtype.itemsize

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows, (rows, *row_shape)."""
        assert rows.shape[1:] == self.shape[1:]
        data = np.ascontiguousarray(rows, self.dtype)
        place = Path(tempfile.gettempdir(), "rfpipe")
        with storage_errors(place, "writing temporary data", data.nbytes):
            self._file.seek(0, 2)
            self._file.write(data.reshape(-1).view(np.uint8).data)
            self._file.flush()
        self.shape = (len(self) + len(data), *self.shape[1:])

    def __getitem__(self, index: Any) -> NDArray[Any]:
        """Read a part of the array, by any index of an `ndarray`."""
        # pages of a memory map count as memory of the process until the map is deleted
        array: NDArray[Any] = (
            np.memmap(self._file, self.dtype, "r", shape=self.shape)
            if prod(self.shape)
            else np.empty(self.shape, self.dtype)
        )
        part: NDArray[Any] = np.array(array[index])
        return part

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)

    @cached_property
    def _file(self) -> IO[bytes]:
        file = tempfile.TemporaryFile()  # noqa: SIM115
        finalize(self, file.close)
        return file
