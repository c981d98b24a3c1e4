"""Light transport matrices in files of NumPy, HDF5, MATLAB and zarr, dense or sparse."""

from __future__ import annotations

from collections.abc import Iterable
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError
from rfpipe.installation import needing
from rfpipe.transport.base import Transport

RayOrder = Literal["rows", "columns"]
"""Numbering of pixels: row by row (C, NumPy), or column by column (MATLAB's ``image(:)``)."""

Shape = tuple[int, ...]

# First bytes of HDF5, and the length of the header that MATLAB writes before them.
_SIGNATURE, _HEADER = b"\x89HDF\r\n\x1a\n", 512


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
        The ray domains, of M and of N rays; by default those in a file by rfpipe.
    dataset : str, optional
        Name of the dataset in a file with several. If each channel is a dataset, their names,
        separated by commas.
    order : {"rows", "columns"}
        Numbering of camera and projector rays.

    Returns
    -------
    list of ndarray or csr_array, shape (M, N)
        One matrix per channel, rays in row-major order; for `rfpipe.OperatorRig`.

    Raises
    ------
    InputError
        If the file can't be read, if it has several datasets and `dataset` is None, or if its
        array doesn't fit the ray domains. Axes are (M, N), with an axis of 1 or 3 channels first,
        between them, or last.
    """
    path = Path(path)
    names = [None] if dataset is None else [name.strip() for name in dataset.split(",")]
    shapes = {"camera_shape": camera_shape, "projector_shape": projector_shape}
    camera, projector = (
        tuple(_stored_shape(path, side) if shape is None else shape)
        for side, shape in shapes.items()
    )
    read = (_channels(_read(path, name), camera, projector, f"{path}", order) for name in names)
    return [matrix for matrices in read for matrix in matrices]


def _stored_shape(path: Path, name: str) -> NDArray[np.int64]:
    """Read the shape of a ray domain from a file by rfpipe."""
    try:
        content = _read(path, name)
    except InputError as error:
        raise InputError(f"{error}. The file has no shapes of rays; give {name}") from error
    return np.ravel(getattr(content, name, content)).astype(np.int64)


def _read(path: Path, name: str | None) -> Any:
    """Read one array, sparse matrix or transport from a file."""
    suffix = path.suffix.lower()
    readers = {
        ".npy": lambda path, _: np.load(path, allow_pickle=False),
        ".npz": _read_npz,
        ".mat": _read_mat,
        ".zarr": _read_zarr,
        **dict.fromkeys((".h5", ".hdf5", ".hdf"), _read_hdf5),
    }
    if suffix not in readers:
        raise InputError(
            f"{path}: no light transport is read from {suffix or 'such a name'}; expected "
            f"{', '.join(readers)}"
        )
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path, relative to {Path.cwd()}")
    try:
        with needing("pictures", f"reading {path}"):
            matrix = readers[suffix](path, name)
    except InputError:
        raise
    except Exception as error:  # the libraries of the formats raise errors of any kind
        raise InputError(f"{path}: can't be read as {suffix}: {error}") from error
    return matrix


def _read_npz(path: Path, name: str | None) -> Any:
    with np.load(path, allow_pickle=False) as file:
        if {"format", "data", "shape"} <= set(file.files):
            from scipy import sparse

            return sparse.load_npz(path)
        return file[_dataset_name(path, file.files, name)]


def _read_mat(path: Path, name: str | None) -> Any:
    from scipy.io import loadmat, whosmat

    with path.open("rb") as file:
        head = file.read(_HEADER + len(_SIGNATURE))
    if _SIGNATURE in (head[: len(_SIGNATURE)], head[_HEADER:]):  # version 7.3
        return _read_hdf5(path, name)
    chosen = _dataset_name(path, [entry[0] for entry in whosmat(str(path))], name)
    return loadmat(str(path), variable_names=[chosen], spmatrix=False)[chosen]


def _read_hdf5(path: Path, name: str | None) -> Any:
    import h5py

    with h5py.File(path, "r") as file:
        return _read_group(path, file, name)


def _read_zarr(path: Path, name: str | None) -> Any:
    import zarr

    from rfpipe.transport.storage import open_transport

    try:
        return open_transport(path)
    except StoreError:  # not one of rfpipe's
        return _read_group(path, zarr.open(path, mode="r"), name)


def _read_group(path: Path, group: Any, name: str | None) -> Any:
    """Read an array of a group of HDF5 or zarr, or the array itself in place of a group."""
    item = group
    if hasattr(group, "keys"):
        names = [key for key in group if not key.startswith("#")]
        item = group[name if name and name in group else _dataset_name(path, names, name)]
    if hasattr(item, "keys"):
        raise InputError(
            f"{path}: {name or item.name} is a group, not an array; name a dataset. A sparse "
            "matrix is read from a .mat of version 7, or from a file by scipy.sparse.save_npz"
        )
    if item.attrs.get("MATLAB_class") == b"char":
        raise InputError(f"{path}: {name or item.name} is text; light transport is real numbers")
    # MATLAB stores its axes in reverse order
    return item[...].transpose() if "MATLAB_class" in item.attrs else item[...]


def _dataset_name(path: Path, names: Iterable[str], name: str | None) -> str:
    """Return the name of the dataset to read: `name`, or the only one."""
    datasets = sorted(names)
    if name is None and {"T", "camera_shape"} <= {*datasets}:
        return "T"  # of a file by rfpipe
    if name is None and len(datasets) == 1:
        return datasets[0]
    if name not in datasets:
        remedy = "name one as dataset" if name is None else f"there is no {name}"
        raise InputError(f"{path}: holds {', '.join(datasets) or 'nothing'}; {remedy}")
    return name


def _channels(
    content: Any, camera: Shape, projector: Shape, name: str, order: RayOrder
) -> list[Any]:
    """Return the content of a file as one matrix (M, N) per channel, rays in row-major order."""
    from scipy import sparse

    shape = prod(camera), prod(projector)
    if isinstance(content, Transport):
        shapes = content.camera_shape, content.projector_shape
        if shapes != (camera, projector):
            raise _misfit(name, tuple(map(prod, shapes)), camera, projector)
        return [content.channel(index) for index in range(content.channels)]
    is_sparse = bool(sparse.issparse(content))
    dtype: Any = content.dtype if is_sparse else np.asarray(content).dtype
    if dtype.kind not in "fiub":
        raise InputError(
            f"{name}: holds {dtype}; light transport is real numbers. Save the real part, or the "
            "absolute values, as an array of numbers"
        )
    if is_sparse:
        matrices: list[Any] = [sparse.csr_array(content)]
    else:
        array = np.asarray(content)
        array = array[None] if array.ndim == 2 else array
        by_channel = (np.moveaxis(array, axis, 0) for axis in range(array.ndim))
        fitting = (it for it in by_channel if len(it) in (1, 3) and it.shape[1:] == shape)
        matrices = list(np.ascontiguousarray(next(fitting, np.zeros((1, 0)))))
    if matrices[0].shape != shape:
        raise _misfit(name, content.shape, camera, projector)
    if order == "columns":
        rows, columns = _by_columns(camera), _by_columns(projector)
        matrices = [matrix[rows][:, columns] for matrix in matrices]
    return matrices


def _by_columns(shape: Shape) -> NDArray[np.int64]:
    """Return the number of each ray, in row-major order, when counted column by column."""
    *views, height, width = shape
    return np.arange(prod(shape)).reshape(*views, width, height).swapaxes(-1, -2).reshape(-1)


def _misfit(name: str, shape: Shape, camera: Shape, projector: Shape) -> InputError:
    rows, columns = prod(camera), prod(projector)
    advice = " Its axes seem to be exchanged: transpose it." if shape == (columns, rows) else ""
    return InputError(
        f"{name}: holds an array of shape {shape}; camera rays {camera} and projector rays "
        f"{projector} need ({rows}, {columns}), with channels (1 or 3) as a third axis.{advice} "
        "Check shape and camera_shape"
    )
