"""Recording a scene's transport matrix once, in pieces, on disk.

The matrix is traced twice, with other random numbers; the mean is kept, and what the halves differ
by tells its noise. Pieces, of so many camera pixels (or, for caustics, projector pixels) that they
fit into memory, are written as they are done, so that a recording that was stopped goes on. At the
end they are put together; on a coaxial rig ``(T + T^T) / 2``, since light goes either way alike
(2.10), is nearer to the truth by a square root of two.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack

from rfpipe.errors import InputError, IntegrityError, LockedError, StoreError
from rfpipe.provenance import versions
from rfpipe.store import open_arrays, write_arrays
from rfpipe.store.files import remove_tree
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest
from rfpipe_mitsuba.variant import variant_versions
from rfpipe_mitsuba.views import Side
from rfpipe_mitsuba.world import Light

Double = NDArray[np.float64]
Channels = list[csr_array[np.float32]]

_PIECE_BYTES = 192 * 2**20  # of the sums of one piece
_WAIT_SECONDS = 1.0


@dataclass(frozen=True)
class Recording:
    """A recorded matrix on disk, and what is known of its noise.

    Attributes
    ----------
    folder : Path
    pieces : tuple of (int, int)
        First camera pixel of each piece, and the one after its last.
    noise : dict of str to dict
        Of the picture ``half_lit``: the standard error of radiance, relative to the picture's norm,
        over the `whole` and where no direct light falls (`unlit`).
    scale : float
        What entries are multiplied by.
    versions : dict of str to str
        Of all that it was made with.
    """

    folder: Path
    pieces: tuple[tuple[int, int], ...]
    noise: dict[str, dict[str, float]]
    scale: float
    versions: dict[str, str]

    def piece(self, index: int) -> Channels:
        """Read a run of rows, one matrix a channel, without the scale."""
        return _read(_transport(self.folder, index))


def record(
    scene: Callable[[], Any],
    camera: Side,
    projector: Side,
    light: Light,
    folder: Path,
    *,
    coaxial: bool,
) -> Recording:
    """Record the transport of the scene that `scene` returns, or find the recording in the folder.

    Another process that wants it waits for the one that makes it.

    Raises
    ------
    InputError
        When no light comes back to the camera.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    manifest, lock = folder / "recording.json", StoreLock(folder / "recording")
    while not manifest.exists():
        try:
            lock.acquire()
        except LockedError:
            time.sleep(_WAIT_SECONDS)
            continue
        with lock:
            if not manifest.exists():
                _record(scene(), camera, projector, light, folder, coaxial)
    facts = read_manifest(manifest)
    pieces = tuple((first, last) for first, last in facts["pieces"])
    return Recording(folder, pieces, facts["noise"], facts["scale"], facts["versions"])


def _record(
    scene: Any, camera: Side, projector: Side, light: Light, folder: Path, coaxial: bool
) -> None:
    from rfpipe_mitsuba.rendering import brightness
    from rfpipe_mitsuba.tracing import Tracer

    tracer = Tracer(scene, camera, projector, light)
    if coaxial and not tracer.is_whole:
        coaxial = False
        warnings.warn(
            "the scene has mirrors or lenses, but caustics aren't followed: the transport that is "
            "recorded isn't symmetric, which methods for coaxial rigs rely on",
            stacklevel=2,
        )
    rows = _traced(folder, tracer.rows, camera.rays, projector.rays)
    columns = _traced(folder, tracer.columns, projector.rays, camera.rays) if light.caustics else {}
    half_lit = np.zeros((len(projector.pinholes), *projector.shape))
    half_lit[..., : projector.shape[1] // 2] = 1
    pattern, pictures, unlit = half_lit.ravel(), [], []
    entries = 0
    for index, (first, last) in enumerate(rows):
        halves = [_assembled(rows, columns, half, first, last) for half in (0, 1)]
        if coaxial:
            back = [_assembled(columns, rows, half, first, last) for half in (0, 1)]
            halves = [_mean(*pair) for pair in zip(halves, back, strict=True)]
        mean = _mean(*halves)
        entries += sum(channel.nnz for channel in mean)
        pictures.append([[np.asarray(matrix @ pattern) for matrix in half] for half in halves])
        unlit.append(np.einsum("iok,o->ik", tracer.direct(first, last), pattern) == 0)
        _write(_transport(folder, index), mean)
    if not entries:
        raise InputError(
            "no light comes back to the camera: nothing that it sees is lit by the projector; turn "
            "them towards the same part of the scene, and look whether one stands within a body"
        )
    one, other = np.moveaxis(np.concatenate(pictures, axis=2), 1, 2)  # (2, M, 3)
    dark = np.concatenate(unlit)
    write_manifest(
        folder / "recording.json",
        {
            "pieces": list(rows),
            "noise": {
                "half_lit": {
                    "whole": _relative(one - other, one + other),
                    "unlit": _relative((one - other)[dark], (one + other)[dark]),
                }
            },
            "scale": brightness(scene, projector),
            "light": light.describe(),
            "versions": {**versions(), **variant_versions()},
        },
    )
    for path in (*rows.values(), *columns.values()):
        remove_tree(path)


def _transport(folder: Path, index: int) -> Path:
    """Where the rows of a piece are."""
    return folder / f"transport_{index:04d}.zarr"


def _traced(
    folder: Path, trace: Callable[[int, int, int], Double], count: int, others: int
) -> dict[tuple[int, int], Path]:
    """Trace `count` rows or columns of `others` entries, in runs that fit into memory.

    Returns the file of each run, three channels of either half, by its first and last + 1 ray.
    """
    length = max(1, min(count, _PIECE_BYTES // (others * 3 * 8)))
    runs = {}
    for first in range(0, count, length):
        last = min(first + length, count)
        path = runs[first, last] = folder / f"{trace.__name__}_{first:08d}.zarr"
        try:
            open_arrays(path)
        except (StoreError, IntegrityError):
            halves = [trace(half, first, last).astype(np.float32) for half in (0, 1)]
            _write(path, [csr_array(half[..., k]) for half in halves for k in range(3)])
    return runs


def _assembled(
    along: dict[tuple[int, int], Path],
    across: dict[tuple[int, int], Path],
    half: int,
    first: int,
    last: int,
) -> Channels:
    """Rows of one half of the matrix: those traced by row, and those of what goes by column."""
    parts = [_read(along[first, last], half)] if along else []
    if across:
        turned = [[each[:, first:last].T for each in _read(path, half)] for path in across.values()]
        parts.append([hstack(blocks).tocsr() for blocks in zip(*turned, strict=True)])
    return [sum(each[1:], each[0]).tocsr() for each in zip(*parts, strict=True)]


def _mean(one: Channels, other: Channels) -> Channels:
    return [((a + b) * np.float32(0.5)).tocsr() for a, b in zip(one, other, strict=True)]


def _relative(difference: Double, total: Double) -> float:
    """Length of a difference beside a total; 0 where there is no light."""
    length = float(np.linalg.norm(total))
    return float(np.linalg.norm(difference)) / length if length else 0.0


def _write(path: Path, matrices: Channels) -> None:
    """Write matrices of one shape."""
    arrays: dict[str, NDArray[Any]] = {}
    for index, matrix in enumerate(matrices):
        arrays[f"values_{index}"] = matrix.data.astype(np.float32)
        arrays[f"columns_{index}"] = matrix.indices.astype(np.int32)
        arrays[f"starts_{index}"] = matrix.indptr.astype(np.int64)
    write_arrays(path, arrays, {"others": matrices[0].shape[1]})


def _read(path: Path, half: int = 0) -> Channels:
    """Read the three matrices of a half, one a channel."""
    bundle = open_arrays(path)
    matrices = []
    for index in range(3 * half, 3 * half + 3):
        starts = bundle.read(f"starts_{index}")
        parts = bundle.read(f"values_{index}"), bundle.read(f"columns_{index}"), starts
        matrices.append(csr_array(parts, shape=(len(starts) - 1, bundle.attributes["others"])))
    return matrices
