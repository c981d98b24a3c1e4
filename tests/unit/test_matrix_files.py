"""Light transport from files of other programs, and as a scene in settings."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import dask.array
import h5py
import numpy as np
import pytest
import scipy.io
import zarr
from scipy import sparse

from rfpipe import OperatorRig, acquire, read_matrix
from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes import scene_from_config
from rfpipe.testing import SceneContract
from rfpipe.transport import save_transport
from rfpipe.transport.dense import DenseTransport

CAMERA, PROJECTOR = (4, 5), (3, 6)
T = np.random.default_rng(0).random((3, 20, 18))
BY_COLUMNS = T.reshape(3, *CAMERA, *PROJECTOR).transpose(0, 2, 1, 4, 3).reshape(3, 20, 18)


def read(path: Path, **options):
    return [
        part.toarray() if sparse.issparse(part) else part
        for part in read_matrix(path, CAMERA, PROJECTOR, **options)
    ]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_channels_may_be_on_any_axis(tmp_path: Path, axis: int) -> None:
    np.save(tmp_path / "t.npy", np.moveaxis(T, 0, axis))
    np.testing.assert_array_equal(read(tmp_path / "t.npy"), T)


def test_numpy_and_scipy_archives_are_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "two.npz", light=T, notes=3)
    np.testing.assert_array_equal(read(tmp_path / "two.npz", dataset="light"), T)
    with pytest.raises(InputError, match=r"holds light, notes; name one as dataset"):
        read(tmp_path / "two.npz")
    sparse.save_npz(tmp_path / "sparse.npz", sparse.csr_array(T[0]))
    np.testing.assert_array_equal(read(tmp_path / "sparse.npz"), T[:1])


def test_both_kinds_of_matlab_files_are_read(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "old.mat", {"T": np.moveaxis(BY_COLUMNS, 0, -1)})
    np.testing.assert_array_equal(read(tmp_path / "old.mat", order="columns"), T)
    scipy.io.savemat(tmp_path / "sparse.mat", {"T": sparse.csc_array(T[1])})
    np.testing.assert_array_equal(read(tmp_path / "sparse.mat"), T[1:2])
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        dataset = file.create_dataset("T", data=np.moveaxis(BY_COLUMNS, 0, -1).transpose())
        dataset.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_group("S").attrs["MATLAB_sparse"] = np.uint64(20)
    np.testing.assert_array_equal(read(tmp_path / "v73.mat", dataset="T", order="columns"), T)
    with pytest.raises(InputError, match=r"S is a group.*\.mat of version 7"):
        read(tmp_path / "v73.mat", dataset="S")


def test_hdf5_and_zarr_with_separate_channels_are_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "t.h5", "w") as file:
        for index, channel in enumerate(T):
            file[f"c{index}"] = channel
    np.testing.assert_array_equal(read(tmp_path / "t.h5", dataset="c0, c1, c2"), T)
    zarr.open_group(tmp_path / "t.zarr", mode="w").create_array("T", data=T)
    np.testing.assert_array_equal(read(tmp_path / "t.zarr"), T)


def test_a_stored_transport_is_a_scene(tmp_path: Path) -> None:
    result = acquire(OperatorRig(T, CAMERA, PROJECTOR), "brute_force", progress=False).transport
    save_transport(result, tmp_path / "t.zarr")
    settings = {"file": str(tmp_path / "t.zarr"), "shape": PROJECTOR, "camera_shape": CAMERA}
    scene = scene_from_config(SceneSettings.of("matrix", **settings))
    np.testing.assert_allclose(scene.dense(1), T[1], rtol=1e-6)
    for name in ("t.npz", "t.h5", "t.mat", "t.zarr"):
        result.save(tmp_path / name)
        rig = OperatorRig(read_matrix(tmp_path / name), CAMERA, PROJECTOR)
        image = rig.capture(np.ones((1, *PROJECTOR), np.float32), [(0, 0)])[0, 0]
        np.testing.assert_allclose(image.reshape(20, 3).T, T.sum(axis=2), rtol=1e-6)
    np.savez(tmp_path / "other.npz", T=T)
    with pytest.raises(InputError, match=r"there is no camera_shape.*give camera_shape"):
        read_matrix(tmp_path / "other.npz")


@pytest.mark.parametrize("kind", [zarr.array, dask.array.from_array])
def test_arrays_of_other_libraries_are_matrices_and_pictures(kind) -> None:
    matrices = (kind(T), [kind(channel) for channel in T])
    light = np.random.default_rng(1).random(PROJECTOR)
    for rig in (OperatorRig(matrix, CAMERA, PROJECTOR) for matrix in matrices):
        result = acquire(rig, "brute_force", progress=False).transport
        np.testing.assert_allclose(result.toarray(), T, rtol=1e-6)
        assert (result.relight(kind(light)) == result.relight(light)).all()
        assert (result @ kind(light.ravel()) == result @ light.ravel()).all()


def test_a_labelled_matrix_for_xarray(monkeypatch: pytest.MonkeyPatch) -> None:
    transport = DenseTransport(CAMERA, PROJECTOR, 3, [], {"matrix": T.astype(np.float32)})
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match=r'pip install --editable "\.\[xarray\]"'):
        transport.to_xarray()
    made = lambda *given: SimpleNamespace(values=given[0], coords=given[1], dims=given[2])  # noqa: E731
    monkeypatch.setitem(sys.modules, "xarray", SimpleNamespace(DataArray=made))
    result = transport.to_xarray(rows=[3, 5])
    assert result.dims == ("channel", "camera", "projector")
    assert result.coords["camera"].tolist() == [3, 5]
    assert (result.values == transport.toarray(rows=[3, 5])).all()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.npy", "no such file"),
        ("t.txt", "no light transport is read from .txt"),
        ("turned.npy", r"shape \(18, 20\).*seem to be exchanged"),
        ("text.npy", "holds <U1"),
        ("broken.mat", "can't be read as .mat"),
    ],
)
def test_invalid_files_are_rejected_with_a_reason(tmp_path: Path, name: str, message: str) -> None:
    np.save(tmp_path / "turned.npy", T[0].T)
    np.save(tmp_path / "text.npy", np.full((20, 18), "a"))
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0" * 40)
    (tmp_path / "t.txt").touch()
    with pytest.raises(InputError, match=message):
        read(tmp_path / name)


COMPLEX = T[0] + 1e-9j
PAIR = np.zeros((20, 18), [("real", "f8"), ("imag", "f8")])
SPARSE = [sparse.csr_array, sparse.coo_array, sparse.bsr_array, sparse.dia_array, sparse.csc_matrix]


def write_hdf5(path: Path, data: np.ndarray, kind: bytes | None = None) -> None:
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("T", data=data)
        if kind:
            dataset.attrs["MATLAB_class"] = np.bytes_(kind)


NOT_REAL = {
    "dense.npy": lambda path: np.save(path, COMPLEX),
    "structured.npy": lambda path: np.save(path, PAIR),
    "objects.npy": lambda path: np.save(path, T.astype(object), allow_pickle=True),
    "dates.npy": lambda path: np.save(path, np.zeros((20, 18), "M8[s]")),
    "dense.npz": lambda path: np.savez(path, T=COMPLEX),
    "objects.npz": lambda path: np.savez(path, T=T.astype(object)),
    **{
        f"{kind.__name__}.npz": lambda path, kind=kind: sparse.save_npz(path, kind(COMPLEX))
        for kind in SPARSE
    },
    "dense.mat": lambda path: scipy.io.savemat(path, {"T": COMPLEX}),
    "sparse.mat": lambda path: scipy.io.savemat(path, {"T": sparse.csc_array(COMPLEX)}),
    "cells.mat": lambda path: scipy.io.savemat(path, {"T": np.array([T[0], None, ""], object)[:1]}),
    "struct.mat": lambda path: scipy.io.savemat(path, {"T": {"a": T}}),
    "text.mat": lambda path: scipy.io.savemat(path, {"T": "text"}),
    "dense_73.mat": lambda path: write_hdf5(path, PAIR.T, b"double"),
    "text_73.mat": lambda path: write_hdf5(path, np.ones((18, 20), "u2"), b"char"),
    "dense.h5": lambda path: write_hdf5(path, COMPLEX),
    "pair.h5": lambda path: write_hdf5(path, PAIR),
    "empty.h5": lambda path: write_hdf5(path, h5py.Empty("f4")),
    "dense.zarr": lambda path: zarr.open_group(path, mode="w").create_array("T", data=COMPLEX),
}


@pytest.mark.parametrize("name", NOT_REAL)
@pytest.mark.filterwarnings("error")
def test_matrices_that_are_not_real_are_rejected(tmp_path: Path, name: str) -> None:
    NOT_REAL[name](tmp_path / name)
    expected = "real numbers|Object arrays cannot be loaded"
    with pytest.raises(InputError, match=rf"{re.escape(name)}: .*(?:{expected})"):
        read(tmp_path / name)


@pytest.mark.parametrize("kind", ["bool", "uint8", "int32", "float16", ">f4", "longdouble"])
def test_matrices_of_any_real_kind_are_read(tmp_path: Path, kind: str) -> None:
    values = (4 * T[0]).astype(kind)
    np.save(tmp_path / "dense.npy", values)
    np.testing.assert_array_equal(read(tmp_path / "dense.npy")[0], values)
    if kind not in ("float16", ">f4", "longdouble"):  # sparse matrices don't have this type
        sparse.save_npz(tmp_path / "sparse.npz", sparse.csr_array(values))
        np.testing.assert_array_equal(read(tmp_path / "sparse.npz")[0], values)


class TestMatrixScene(SceneContract):
    coaxial = False

    @pytest.fixture(autouse=True)
    def file(self, tmp_path: Path) -> None:
        self.path = tmp_path / "t.npy"
        np.save(self.path, T)

    def make_scene(self):
        settings = {"shape": PROJECTOR, "camera_shape": CAMERA, "brightest": 1.5}
        return scene_from_config(SceneSettings.of("matrix", file=str(self.path), **settings))

    def test_the_matrix_is_scaled(self) -> None:
        assert self.make_scene().apply(np.ones((1, 18))).max() == pytest.approx(1.5)

    def test_channels_must_agree_with_the_settings(self) -> None:
        settings = {"shape": PROJECTOR, "camera_shape": CAMERA, "channels": 1}
        with pytest.raises(InputError, match=r"has 3 channels.*Set it to 3"):
            scene_from_config(SceneSettings.of("matrix", file=str(self.path), **settings))

    def test_negative_entries_are_refused(self) -> None:
        np.save(self.path, np.where(T > 0.01, T, -0.01))
        with pytest.raises(InputError, match="finite and not negative"):
            self.make_scene()
