"""Light transport from files of other programs: NumPy, HDF5 and MATLAB, zarr; dense or sparse."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError, installing

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

__all__ = ["RayOrder", "read_matrix"]

RayOrder = Literal["rows", "columns"]
"""How pixels are numbered: row by row (C, NumPy), or column by column (MATLAB's ``image(:)``)."""

_HDF5, _CHANNELS = (".h5", ".hdf5", ".hdf"), (1, 3)
_SPARSE = ({"data", "indices", "indptr"}, {"data", "ir", "jc"})
# What MATLAB says of the rows of a sparse matrix, whose group holds no shape.
_MATLAB_ROWS = "MATLAB_sparse"
# How HDF5 begins, where MATLAB may have put a block of its own before it.
_SIGNATURE, _BLOCK = b"\x89HDF\r\n\x1a\n", 512

Matrices = list[Any]


def read_matrix(
    path: str | Path,
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    dataset: str | None = None,
    order: RayOrder = "rows",
) -> Matrices:
    """Read a light transport matrix from a file.

    Parameters
    ----------
    path : path
        ``.npy``; ``.npz`` of arrays, or of a matrix that `scipy.sparse.save_npz` wrote; ``.mat`` of
        any version; ``.h5`` or ``.hdf5``; or a zarr folder. Sparse matrices in HDF5 and zarr are
        groups of ``data``, ``indices`` and ``indptr`` (rows compressed, or columns where an
        attribute ``format`` says csc), or as MATLAB writes them.
    camera_shape, projector_shape : tuple of int
        The ray domains, of M and of N rays.
    dataset : str, optional
        Name in a file that holds several; for channels in datasets of their own, their names with
        commas between them.
    order : {"rows", "columns"}
        How camera and projector rays are numbered where the array has one axis for them.

    Returns
    -------
    list of ndarray or csr_array, shape (M, N)
        One matrix a channel, rays in row-major order; for `rfpipe.OperatorRig`.

    Raises
    ------
    InputError
        When the file can't be read, holds several datasets and none is named, or fits no shape:
        says which shapes would. Axes may be (M, N), each of M and N as one axis or as those of
        its domain, with an axis of 1 or 3 channels first, between, or last.
    """
    path = Path(path)
    names = [None] if dataset is None else [name.strip() for name in dataset.split(",")]
    found: Matrices = []
    for name in names:
        found += _channels(_read(path, name), camera_shape, projector_shape, f"{path}", order)
    return found


def _read(path: Path, name: str | None) -> Any:
    """Return one array or sparse matrix of a file."""
    suffix = path.suffix.lower()
    readers: dict[str, Callable[[Path, str | None], Any]] = {
        ".npy": lambda path, _: np.load(path, allow_pickle=False),
        ".npz": _npz,
        ".mat": _mat,
        ".zarr": _zarr,
        **dict.fromkeys(_HDF5, _hdf5),
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
    names = [entry[0] for entry in whosmat(str(path))]
    chosen = _chosen(path, names, name)
    return loadmat(str(path), variable_names=[chosen], spmatrix=False)[chosen]


def _hdf5(path: Path, name: str | None) -> Any:
    import h5py

    with h5py.File(path, "r") as file:
        held = [key for key in file if not key.startswith("#")]
        item = file[name] if name and name in file else file[_chosen(path, held, name)]
        by_matlab = "MATLAB_class" in item.attrs
        if isinstance(item, h5py.Group):
            return _sparse(path, item, dict(item.attrs))
        array = item[()]
        # MATLAB counts its axes the other way round
        return array.transpose() if by_matlab else array


def _zarr(path: Path, name: str | None) -> Any:
    import zarr

    from rfpipe.transport.storage import open_transport

    try:
        return open_transport(path)
    except StoreError:  # not one of rfpipe's
        opened: Any = zarr.open(path, mode="r")
    if isinstance(opened, zarr.Array):
        return opened[...]
    held = list(opened.keys())
    is_sparse = any(parts <= set(held) for parts in _SPARSE)
    item = opened if is_sparse and name is None else opened[_chosen(path, held, name)]
    if isinstance(item, zarr.Array):
        return item[...]
    return _sparse(path, item, dict(item.attrs))


def _sparse(path: Path, group: Any, attributes: dict[str, Any]) -> csr_array[Any] | csc_array[Any]:
    """Return the sparse matrix that a group holds."""
    from scipy.sparse import csc_array, csr_array

    parts = {key: np.asarray(group[key][()]) for key in group if key in set().union(*_SPARSE)}
    if set(parts) == _SPARSE[1]:
        rows = int(attributes[_MATLAB_ROWS])
        return csc_array(
            (parts["data"], parts["ir"].astype(np.int64), parts["jc"].astype(np.int64)),
            shape=(rows, len(parts["jc"]) - 1),
        )
    if set(parts) != _SPARSE[0]:
        raise InputError(
            f"{path}: the group {group.name} holds {', '.join(group)}; a sparse matrix is data, "
            "indices and indptr. Name the dataset"
        )
    shape = attributes.get("shape", group["shape"][()] if "shape" in group else None)
    stated = attributes.get("format", "csr")
    kind = (
        csc_array
        if (stated.decode() if isinstance(stated, bytes) else stated) == "csc"
        else (csr_array)
    )
    whole: Any = None if shape is None else tuple(int(extent) for extent in shape)
    return kind((parts["data"], parts["indices"], parts["indptr"]), shape=whole)


def _chosen(path: Path, names: Iterable[str], name: str | None) -> str:
    """Return the dataset to read: the one that is named, or the only one there is."""
    held = sorted(names)
    if name is None and len(held) == 1:
        return held[0]
    if name not in held:
        asked = "name one as dataset" if name is None else f"there is no {name}"
        raise InputError(f"{path}: holds {', '.join(held) or 'nothing'}; {asked}")
    return name


def _channels(
    held: Any,
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    name: str,
    order: RayOrder,
) -> Matrices:
    """Return what a file holds as matrices (M, N), rays in row-major order."""
    from scipy import sparse

    from rfpipe.transport.base import Transport

    if isinstance(held, Transport):
        return _of_transport(held, camera_shape, projector_shape, name)
    rows, columns = prod(camera_shape), prod(projector_shape)
    if sparse.issparse(held):
        matrix: Any = sparse.csr_array(held)  # type: ignore[call-overload]
        if matrix.shape != (rows, columns):
            raise _misfit(name, matrix.shape, camera_shape, projector_shape)
        if order == "columns":
            matrix = matrix[_by_columns(camera_shape)][:, _by_columns(projector_shape)]
        return [sparse.csr_array(matrix)]
    array = np.asarray(held)
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name}: holds {array.dtype}; light transport is real numbers")
    for camera_axes in ((rows,), tuple(camera_shape)):
        for projector_axes in ((columns,), tuple(projector_shape)):
            planar = _planar(array, camera_axes, projector_axes)
            if planar is not None:
                return [
                    _numbered(matrix, camera_shape, projector_shape, camera_axes, projector_axes)
                    if order == "columns"
                    else np.ascontiguousarray(matrix.reshape(rows, columns))
                    for matrix in planar
                ]
    raise _misfit(name, array.shape, camera_shape, projector_shape)


def _planar(
    array: NDArray[Any], camera: tuple[int, ...], projector: tuple[int, ...]
) -> NDArray[Any] | None:
    """Return an array of axes (C, *camera, *projector) of one that has its channels anywhere."""
    if array.shape == camera + projector:
        return array[None]
    for axis in (0, len(camera), len(camera) + len(projector)):
        if array.ndim == len(camera) + len(projector) + 1 and array.shape[axis] in _CHANNELS:
            moved = np.moveaxis(array, axis, 0)
            if moved.shape[1:] == camera + projector:
                return moved
    return None


def _numbered(
    matrix: NDArray[Any],
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    camera_axes: tuple[int, ...],
    projector_axes: tuple[int, ...],
) -> NDArray[Any]:
    """Return a matrix (M, N) in row-major order of one whose joined axes go column by column."""
    rows, columns = prod(camera_shape), prod(projector_shape)
    flat = matrix.reshape(rows, columns)
    if len(camera_axes) == 1:
        flat = flat[_by_columns(camera_shape)]
    if len(projector_axes) == 1:
        flat = flat[:, _by_columns(projector_shape)]
    return np.ascontiguousarray(flat)


def _by_columns(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return, for each ray in row-major order, its number when counted column by column."""
    *views, height, width = shape
    image = np.arange(height * width).reshape(width, height).T
    stack = np.arange(prod(views))[:, None] * (height * width) + image.reshape(-1)
    return np.asarray(stack.reshape(-1))


def _of_transport(
    transport: Any, camera_shape: tuple[int, ...], projector_shape: tuple[int, ...], name: str
) -> Matrices:
    """Return the operators of a transport that rfpipe stored."""
    own = transport.camera_shape, transport.projector_shape
    if own != (tuple(camera_shape), tuple(projector_shape)):
        raise _misfit(name, tuple(map(prod, own)), camera_shape, projector_shape)
    return [transport.channel(index) for index in range(transport.channels)]


def _misfit(
    name: str, found: tuple[int, ...], camera: tuple[int, ...], projector: tuple[int, ...]
) -> InputError:
    rows, columns = prod(camera), prod(projector)
    turned = " Its axes seem to be exchanged: transpose it." if found == (columns, rows) else ""
    return InputError(
        f"{name}: holds an array of shape {found}; camera rays {camera} and projector rays "
        f"{projector} want ({rows}, {columns}), with channels (1 or 3) as a third axis, or the "
        f"rays' own axes in place of either.{turned} Check shape and camera_shape"
    )
