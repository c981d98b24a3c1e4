"""Matrices in files: readable by other programs, streamed, and complete or absent."""

import math
import sys
from pathlib import Path

import h5py
import mat73
import numpy as np
import pytest
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.matrix_export import MATRIX_FILES

CAMERA, PROJECTOR = (3, 5), (2, 4, 3)


def matrix_of(channels: int) -> NDArray[np.float32]:
    return np.random.default_rng(1).random((channels, 15, 24), dtype=np.float32)


def transport_of(channels: int) -> DenseTransport:
    return DenseTransport(CAMERA, PROJECTOR, channels, [], {"matrix": matrix_of(channels)})


def read(path: Path) -> dict[str, NDArray]:
    """Read a file with a library of its format; T has the shape (C, rows, columns)."""
    if path.suffix == ".npz":
        with np.load(path) as archive:
            return dict(archive)
    if path.suffix == ".mat":
        arrays = mat73.loadmat(path)
        matrix = arrays["T"] if arrays["T"].ndim == 3 else arrays["T"][..., None]
        return {**arrays, "T": np.moveaxis(matrix, -1, 0)}
    with h5py.File(path) as file:
        arrays = {name: dataset[...] for name, dataset in file.items()}
        return {**arrays, "about": file.attrs["about"]}


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("suffix", MATRIX_FILES)
def test_other_programs_read_the_matrix(tmp_path: Path, suffix: str, channels: int) -> None:
    path = tmp_path / f"matrix{suffix}"
    transport_of(channels).save(path)
    saved = read(path)
    np.testing.assert_allclose(saved["T"], matrix_of(channels), rtol=1e-6)
    assert saved["T"].dtype == np.float32
    assert saved["camera_shape"].tolist() == list(CAMERA)
    assert saved["projector_shape"].tolist() == list(PROJECTOR)
    assert saved["rows"].tolist() == list(range(15))
    assert "Light transport T by rfpipe" in str(saved["about"])


@pytest.mark.parametrize("suffix", MATRIX_FILES)
@pytest.mark.parametrize(("rows", "columns"), [([7, 2], None), (None, [9]), ([3], [1, 0])])
def test_selected_rays_are_written(tmp_path: Path, suffix: str, rows, columns) -> None:
    path = tmp_path / f"matrix{suffix}"
    transport_of(3).save(path, rows=rows, columns=columns)
    saved = read(path)
    expected = transport_of(3).toarray(rows, columns)
    np.testing.assert_array_equal(saved["T"].reshape(expected.shape), expected)
    assert np.atleast_1d(saved["rows"]).tolist() == (rows or list(range(15)))
    assert np.atleast_1d(saved["columns"]).tolist() == (columns or list(range(24)))


@pytest.mark.parametrize("suffix", MATRIX_FILES)
@pytest.mark.parametrize("dual", [False, True])
def test_parts_make_the_same_matrix(tmp_path: Path, monkeypatch, suffix: str, dual: bool) -> None:
    monkeypatch.setattr("rfpipe.transport.algebra._BLOCK_BYTES", 2000)
    path = tmp_path / f"matrix{suffix}"
    (transport_of(3).T if dual else transport_of(3)).save(path)
    expected = matrix_of(3).swapaxes(1, 2) if dual else matrix_of(3)
    np.testing.assert_allclose(read(path)["T"], expected, rtol=1e-6)


def test_a_mat_file_gives_images_as_the_documents_say(tmp_path: Path) -> None:
    """The steps of docs/export.md for MATLAB, in NumPy."""
    path = tmp_path / "matrix.mat"
    transport = DenseTransport((3, 5), (4, 6), 3, [], {"matrix": matrix_of(3)})
    transport.save(path)
    with h5py.File(path) as file:  # MATLAB's arrays are the transposed datasets, column by column
        arrays = {name: np.asfortranarray(dataset[...].T) for name, dataset in file.items()}
    assert arrays["camera_shape"].shape == (1, 2)
    p = np.random.default_rng(2).random((4, 6), dtype=np.float32)
    c = arrays["T"][:, :, 1] @ p.T.reshape(-1, order="F")
    height, width = arrays["camera_shape"][0].astype(int)
    image = c.reshape((width, height), order="F").T
    np.testing.assert_allclose(image, transport.relight(p)[..., 1], rtol=1e-5)
    assert arrays["about"].shape[0] == 1


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("matrix.csv", {}, r"the suffix \.csv; expected \.npz .*\.mat .*, \.zarr"),
        ("matrix", {}, "no suffix"),
        ("matrix.npz", {"number_format": "uint8"}, "stored as float32"),
        ("kept.zarr", {"rows": [0]}, "a store has all rays"),
        ("matrix.npz", {"limit_bytes": 1000}, r"3 x 15 x 24 entries.*choose rows or col"),
        ("matrix.mat", {"columns": [24]}, "columns: index 24 is out of bounds"),
    ],
)
def test_invalid_suffixes_and_rays_are_refused(
    tmp_path: Path, name: str, options, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        transport_of(3).save(tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", MATRIX_FILES)
def test_an_interrupted_export_keeps_the_previous_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"matrix{suffix}"
    path.write_text("before")

    class Failing(DenseTransport):
        def forward(self, patterns, channels):
            raise KeyboardInterrupt

        adjoint = forward

    with pytest.raises(KeyboardInterrupt):
        Failing(CAMERA, PROJECTOR, 1, [], {}).save(path)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["before"]


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_the_extra_is_named_where_its_package_is_missing(
    tmp_path: Path, monkeypatch, suffix: str
) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(StoreError, match=r"needs the extra export: .*; run pip install"):
        transport_of(1).save(tmp_path / f"matrix{suffix}")
    assert not list(tmp_path.iterdir())
    transport_of(1).save(tmp_path / "matrix.npz")


def test_a_large_matrix_is_written_in_little_memory(tmp_path: Path, monkeypatch) -> None:
    """A matrix of 15 MB of zeros is written in parts."""
    import tracemalloc

    rays = (40, 48)
    monkeypatch.setattr("rfpipe.transport.algebra._BLOCK_BYTES", 2**19)

    class Zeros(DenseTransport):
        def forward(self, patterns, channels):
            return np.zeros((len(patterns), len(channels), math.prod(rays)), np.float32)

        adjoint = forward

    for suffix in (".npz", ".h5", ".mat"):
        tracemalloc.start()
        Zeros(rays, rays, 1, [], {}).save(tmp_path / f"large{suffix}")
        peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak_bytes < 5e6
