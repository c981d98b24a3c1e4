"""A matrix as numpy's archive, ``.npz``."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from rfpipe.transport.algebra import MEMORY_BUDGET
from rfpipe.transport.files.contents import ABOUT, Contents

__all__ = ["write_npz"]

_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # a zip file's first date: equal matrices give equal bytes


def write_npz(path: Path, contents: Contents) -> None:
    """Write ``T`` (C, rows, columns), what stands beside it, and ``about``, a text."""
    small = {**contents.arrays(), "about": np.array(ABOUT)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in small.items():
            with _member(archive, name) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
        with _member(archive, "T") as member:
            _write_rows(member, contents)


def _member(archive: zipfile.ZipFile, name: str) -> IO[bytes]:
    about = zipfile.ZipInfo(f"{name}.npy", _LONG_AGO)
    about.compress_type = zipfile.ZIP_DEFLATED
    return archive.open(about, "w", force_zip64=True)


def _write_rows(member: IO[bytes], contents: Contents) -> None:
    """Write T as ``.npy``, whose entries follow row by row, channel by channel."""
    header = {"descr": "<f4", "fortran_order": False, "shape": contents.shape}
    np.lib.format.write_array_header_2_0(member, header)
    channels, rows, columns = contents.shape
    if columns < rows and contents.nbytes <= MEMORY_BUDGET:  # columns are quicker had
        whole = np.empty(contents.shape, "<f4")
        for of_rows, of_columns, block in contents.blocks():
            whole[:, of_rows, of_columns] = block
        member.write(whole.data)
        return
    for channel in range(channels):
        for *_, block in contents.blocks(by_rows=True, channels=[channel]):
            member.write(np.ascontiguousarray(block[0], "<f4").data)
