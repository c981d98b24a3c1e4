"""Light transport from files of other programs: NumPy, HDF5 and MATLAB, zarr; dense or sparse."""

from __future__ import annotations

from collections.abc import Iterable
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError, installing
from rfpipe.transport.base import Transport

RayOrder = Literal["rows", "columns"]
"""How pixels are numbered: row by row (C, NumPy), or column by column (MATLAB's ``image(:)``)."""

Shape = tuple[int, ...]

# How HDF5 begins, where MATLAB may have put a block of its own before it.
_SIGNATURE, _BLOCK = b"\x89HDF\r\n\x1a\n", 512


def read_matrix(
    path: str | Path,
    camera_shape: Shape | None = None,
    projector_shape: Shape | None = None,
    dataset: str | None = None,
    order: RayOrder = "rows",
) -> list[Any]:
    """Read a light transport matrix from a file.

    Parameters
    ----------
    path : path
        ``.npy``; ``.npz`` of arrays, or of a matrix that `scipy.sparse.save_npz` wrote; ``.mat`` of
        any version, sparse up to v7; ``.h5`` or ``.hdf5``; or a zarr folder.
    camera_shape, projector_shape : tuple of int, optional
        The ray domains, of M and of N rays; by default those in a file that rfpipe wrote.
    dataset : str, optional
        Name in a file that holds several, of rfpipe's own T; for channels in datasets of their own,
        their names with commas between them.
    order : {"rows", "columns"}
        How camera and projector rays are numbered.

    Returns
    -------
    list of ndarray or csr_array, shape (M, N)
        One matrix a channel, rays in row-major order; for `rfpipe.OperatorRig`.

    Raises
    ------
    InputError
        When the file can't be read, holds several datasets and none is named, or fits no shape:
        says which shapes would. Axes are (M, N), with one of 1 or 3 channels first, between, or
        last.
    """
    path = Path(path)
    names = [None] if dataset is None else [name.strip() for name in dataset.split(",")]
    given = {"camera_shape": camera_shape, "projector_shape": projector_shape}
    camera, projector = (
        tuple(_own(path, side) if shape is None else shape) for side, shape in given.items()
    )
    read = (_channels(_read(path, name), camera, projector, f"{path}", order) for name in names)
    return [matrix for matrices in read for matrix in matrices]


def _own(path: Path, name: str) -> NDArray[np.int64]:
    """Return a ray domain that stands in a file of rfpipe's."""
    try:
        held = _read(path, name)
    except InputError as error:
        raise InputError(f"{error}. Files of rfpipe have shapes of rays; give {name}") from error
    return np.ravel(getattr(held, name, held)).astype(np.int64)


def _read(path: Path, name: str | None) -> Any:
    """Return one array, sparse matrix or transport of a file."""
    suffix = path.suffix.lower()
    readers = {
        ".npy": lambda path, _: np.load(path, allow_pickle=False),
        ".npz": _npz,
        ".mat": _mat,
        ".zarr": _zarr,
        **dict.fromkeys((".h5", ".hdf5", ".hdf"), _hdf5),
    }
    if suffix not in readers:
        raise InputError(
            f"{path}: no light transport is read from {suffix or 'such a name'}; expected "
            f"{', '.join(readers)}"
        )
    if not path.exists():
        raise InputError(f"{path}: no such file, seen from {Path.cwd()}; check its path")
    try:
        return readers[suffix](path, name)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(f"{path}: needs {error.name}; {installing('pictures')}") from error
    except Exception as error:  # whatever the formats' libraries raise
        raise InputError(f"{path}: can't be read as {suffix}: {error}") from error


def _npz(path: Path, name: str | None) -> Any:
    with np.load(path, allow_pickle=False) as file:
        if {"format", "data", "shape"} <= set(file.files):
            from scipy import sparse

            return sparse.load_npz(path)
        return file[_chosen(path, file.files, name)]


def _mat(path: Path, name: str | None) -> Any:
    from scipy.io import loadmat, whosmat

    with path.open("rb") as file:
        head = file.read(_BLOCK + len(_SIGNATURE))
    if _SIGNATURE in (head[: len(_SIGNATURE)], head[_BLOCK:]):  # version 7.3
        return _hdf5(path, name)
    chosen = _chosen(path, [entry[0] for entry in whosmat(str(path))], name)
    return loadmat(str(path), variable_names=[chosen], spmatrix=False)[chosen]


def _hdf5(path: Path, name: str | None) -> Any:
    import h5py

    with h5py.File(path, "r") as file:
        return _of_group(path, file, name)


def _zarr(path: Path, name: str | None) -> Any:
    import zarr

    from rfpipe.transport.storage import open_transport

    try:
        return open_transport(path)
    except StoreError:  # not one of rfpipe's
        return _of_group(path, zarr.open(path, mode="r"), name)


def _of_group(path: Path, group: Any, name: str | None) -> Any:
    """Return an array of a group of HDF5 or zarr, or the array that stands in its place."""
    item = group
    if hasattr(group, "keys"):
        names = [key for key in group if not key.startswith("#")]
        item = group[name if name and name in group else _chosen(path, names, name)]
    if hasattr(item, "keys"):
        raise InputError(
            f"{path}: {name or item.name} is a group, no array; name a dataset. A sparse matrix is "
            "read from a .mat of version 7, or from what scipy.sparse.save_npz writes"
        )
    if item.attrs.get("MATLAB_class") == b"char":
        raise InputError(f"{path}: {name or item.name} is text; light transport is real numbers")
    # MATLAB counts its axes the other way round
    return item[...].transpose() if "MATLAB_class" in item.attrs else item[...]


def _chosen(path: Path, names: Iterable[str], name: str | None) -> str:
    """Return the dataset to read: the one that is named, or the only one there is."""
    datasets = sorted(names)
    if name is None and {"T", "camera_shape"} <= {*datasets}:
        return "T"  # rfpipe's own
    if name is None and len(datasets) == 1:
        return datasets[0]
    if name not in datasets:
        remedy = "name one as dataset" if name is None else f"there is no {name}"
        raise InputError(f"{path}: holds {', '.join(datasets) or 'nothing'}; {remedy}")
    return name


def _channels(held: Any, camera: Shape, projector: Shape, name: str, order: RayOrder) -> list[Any]:
    """Return what a file holds as matrices (M, N), rays in row-major order."""
    from scipy import sparse

    shape = prod(camera), prod(projector)
    if isinstance(held, Transport):
        shapes = held.camera_shape, held.projector_shape
        if shapes != (camera, projector):
            raise _misfit(name, tuple(map(prod, shapes)), camera, projector)
        return [held.channel(index) for index in range(held.channels)]
    is_sparse = bool(sparse.issparse(held))
    dtype: Any = held.dtype if is_sparse else np.asarray(held).dtype
    if dtype.kind not in "fiub":
        raise InputError(
            f"{name}: holds {dtype}; light transport is real numbers. Save the real part, or the "
            "absolute values, as an array of numbers"
        )
    if is_sparse:
        matrices: list[Any] = [sparse.csr_array(held)]
    else:
        array = np.asarray(held)
        array = array[None] if array.ndim == 2 else array
        by_channel = (np.moveaxis(array, axis, 0) for axis in range(array.ndim))
        fitting = (each for each in by_channel if len(each) in (1, 3) and each.shape[1:] == shape)
        matrices = list(np.ascontiguousarray(next(fitting, np.zeros((1, 0)))))
    if matrices[0].shape != shape:
        raise _misfit(name, held.shape, camera, projector)
    if order == "columns":
        rows, columns = _by_columns(camera), _by_columns(projector)
        matrices = [matrix[rows][:, columns] for matrix in matrices]
    return matrices


def _by_columns(shape: Shape) -> NDArray[np.int64]:
    """Return, for each ray in row-major order, its number when counted column by column."""
    *views, height, width = shape
    return np.arange(prod(shape)).reshape(*views, width, height).swapaxes(-1, -2).reshape(-1)


def _misfit(name: str, found: Shape, camera: Shape, projector: Shape) -> InputError:
    rows, columns = prod(camera), prod(projector)
    turned = " Its axes seem to be exchanged: transpose it." if found == (columns, rows) else ""
    return InputError(
        f"{name}: holds an array of shape {found}; camera rays {camera} and projector rays "
        f"{projector} want ({rows}, {columns}), with channels (1 or 3) as a third axis.{turned} "
        "Check shape and camera_shape"
    )
