"""Arrays in temporary files."""

from __future__ import annotations

import errno
import gc
import os
from pathlib import Path

import numpy as np
import pytest

from rfpipe.errors import StoreError
from rfpipe.store import open_arrays, write_arrays
from rfpipe.store.scratch import ScratchArray


def test_parts_are_read_as_from_memory() -> None:
    expected = np.random.default_rng(0).random((7, 2, 30)).astype(np.float32)
    stored = ScratchArray(np.float32, (2, 30))
    assert not len(stored)
    assert stored[:].shape == (0, 2, 30)
    for rows in np.split(expected, [3, 3, 5]):
        stored.append(rows)
    assert len(stored) == 7
    indices = (slice(None), 2, (slice(3, 4), slice(1), slice(5, 9)), (slice(0, 1), 1, [3, 29]))
    for index in indices:
        np.testing.assert_array_equal(stored[index], expected[index])
    np.testing.assert_array_equal(np.asarray(stored), expected)


def test_rows_of_another_shape_are_refused() -> None:
    with pytest.raises(AssertionError):
        ScratchArray(np.int32, (3,)).append(np.zeros((4, 2)))


@pytest.mark.filterwarnings("error")
def test_files_have_no_name_and_are_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    stored = ScratchArray.of(np.arange(5))
    assert not list(tmp_path.iterdir())
    file = stored._file
    del stored
    gc.collect()
    assert file.closed


def test_a_full_disk_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    with pytest.raises(StoreError, match="temporary data failed: No space left"):
        ScratchArray.of(np.arange(5))


def test_a_bundle_is_written_from_temporary_files(tmp_path: Path) -> None:
    array = np.arange(12, dtype=np.float16).reshape(3, 4)
    digest = write_arrays(tmp_path / "stored.zarr", {"values": ScratchArray.of(array)}, {})
    assert digest == write_arrays(tmp_path / "memory.zarr", {"values": array}, {})
    np.testing.assert_array_equal(open_arrays(tmp_path / "stored.zarr").read("values"), array)
