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
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, IntegrityError, LockedError, StoreError
from rfpipe.provenance import generator, versions
from rfpipe.store import open_arrays, write_arrays
from rfpipe.store.files import remove_tree
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest
from rfpipe_mitsuba.brightness import brightness
from rfpipe_mitsuba.light import Light
from rfpipe_mitsuba.views import Views

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from rfpipe_mitsuba.tracing import Tracer

__all__ = ["Recording", "record"]

Double = NDArray[np.float64]

_PIECE_BYTES = 192 * 2**20  # of the sums of one piece
_WAIT_SECONDS = 1.0
_PROBES = ("half_lit", "random", "spot")
_PROBE_SEED = 0
_SPOT = 3  # pixels along either side


@dataclass(frozen=True)
class Recording:
    """A recorded matrix on disk, and what is known of its noise.

    Attributes
    ----------
    folder : Path
    pieces : tuple of (int, int)
        First camera pixel of each piece, and the one after its last.
    noise : dict of str to dict
        By the picture (half_lit, random, spot): the standard error of radiance, relative to the
        picture's norm, over the whole and where no direct light falls (`unlit`).
    scale : float
        What entries are multiplied by.
    """

    folder: Path
    pieces: tuple[tuple[int, int], ...]
    noise: dict[str, dict[str, float]]
    scale: float

    def piece(self, index: int) -> list[csr_array[np.float32]]:
        """Read a run of rows, one matrix a channel, without the scale.

        Raises
        ------
        IntegrityError
            When it is missing or damaged.
        """
        return _read(self.folder / f"transport_{index:04d}.zarr")


def record(
    scene: Callable[[], Any],
    camera: Views,
    projector: Views,
    light: Light,
    folder: Path,
    *,
    coaxial: bool,
    progress: Callable[[str], None] = lambda _message: None,
) -> Recording:
    """Record a transport matrix, or find the one that was recorded.

    Parameters
    ----------
    scene
        Returns Mitsuba's scene.
    camera, projector
        The two sides.
    light
        What is followed.
    folder
        Where the recording is kept. Another process that wants it waits for the one that makes it.
    coaxial
        Whether the two sides are one.
    progress
        Told of each piece that is done.

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
                _record(scene(), camera, projector, light, folder, coaxial, progress)
    found = read_manifest(manifest)
    pieces = tuple((first, last) for first, last in found["pieces"])
    return Recording(folder, pieces, found["noise"], found["scale"])


def _record(
    scene: Any,
    camera: Views,
    projector: Views,
    light: Light,
    folder: Path,
    coaxial: bool,
    progress: Callable[[str], None],
) -> None:
    from rfpipe_mitsuba.tracing import Tracer

    tracer = Tracer(scene, camera, projector, light)
    rows, columns = _all_traced(tracer, camera, projector, light, folder, progress)
    coaxial = coaxial and _symmetric(tracer)
    halves = _halves(rows, columns, camera.rays, coaxial)
    _put_together(folder, rows, columns, coaxial)
    write_manifest(
        folder / "recording.json",
        {
            "pieces": [[piece.first, piece.last] for piece in rows],
            "noise": _noise(halves, _unlit(tracer, rows, _probes(projector))),
            "scale": brightness(scene, projector),
            "light": light.describe(),
            "versions": {**versions(), "mitsuba": metadata.version("mitsuba")},
        },
    )
    for piece in (*rows, *columns):
        remove_tree(piece.path)


def _all_traced(
    tracer: Tracer,
    camera: Views,
    projector: Views,
    light: Light,
    folder: Path,
    progress: Callable[[str], None],
) -> tuple[list[_Piece], list[_Piece]]:
    """Trace rows from the camera and, for caustics, columns from the projector."""
    seen, lit = _probes(camera), _probes(projector)
    rows = [
        _traced(folder / f"rows_{first:08d}.zarr", tracer.rows, first, last, lit, seen, progress)
        for first, last in _runs(camera.rays, projector.rays)
    ]
    columns = [
        _traced(
            folder / f"columns_{first:08d}.zarr", tracer.columns, first, last, seen, lit, progress
        )
        for first, last in _runs(projector.rays, camera.rays)
        if light.caustics
    ]
    return rows, columns


def _symmetric(tracer: Tracer) -> bool:
    """Tell whether a coaxial rig's matrix is symmetric; warn if it isn't."""
    if not tracer.is_whole:
        warnings.warn(
            "the scene has mirrors or lenses, but caustics aren't followed: the transport that is "
            "recorded isn't symmetric, which methods for coaxial rigs rely on",
            stacklevel=2,
        )
    return tracer.is_whole


def _halves(rows: list[_Piece], columns: list[_Piece], rays: int, coaxial: bool) -> Double:
    """Return pictures (2, P, rays, 3) of the probes by either half, of the mean if coaxial.

    Raises
    ------
    InputError
        When they are dark.
    """
    halves = _pictures(rows, columns, rays)
    if coaxial:
        halves = (halves + _pictures(columns, rows, rays)) / 2
    if not halves.any():
        raise InputError(
            "no light comes back to the camera: nothing that it sees is lit by the projector; turn "
            "them towards the same part of the scene, and look whether one stands within a body"
        )
    return halves


def _put_together(folder: Path, rows: list[_Piece], columns: list[_Piece], coaxial: bool) -> None:
    """Write the matrix, in runs of rows; the mean of it and its transpose if coaxial."""
    for index, piece in enumerate(rows):
        matrices = _total(piece.first, piece.last, rows, columns)
        if coaxial:
            back = _total(piece.first, piece.last, columns, rows)
            matrices = [_mean(one, other) for one, other in zip(matrices, back, strict=True)]
        _write(folder / f"transport_{index:04d}.zarr", matrices, {})


def _unlit(tracer: Tracer, rows: list[_Piece], lit: Double) -> NDArray[np.bool_]:
    """Tell which pixels no direct light comes from, under each probe: (P, rays, 3)."""
    dark = [
        np.einsum("iok,po->pik", tracer.direct(piece.first, piece.last), lit) == 0 for piece in rows
    ]
    return np.concatenate(dark, axis=1)


@dataclass(frozen=True)
class _Piece:
    """Rows, or columns, of the matrix that are done: both halves' mean, and their pictures.

    `forth` (2, P, last - first, 3) are the pictures of patterns of the other side, `back` (2, P,
    others, 3) those of this side's, put through the transpose; of either half.
    """

    first: int
    last: int
    path: Path
    forth: Double
    back: Double


def _runs(count: int, others: int) -> list[tuple[int, int]]:
    """Cut `count` rows of `others` entries into runs that fit into memory."""
    length = max(1, min(count, _PIECE_BYTES // (others * 3 * 8)))
    return [(first, min(first + length, count)) for first in range(0, count, length)]


def _traced(
    path: Path,
    trace: Callable[[int, int, int], Double],
    first: int,
    last: int,
    patterns: Double,
    own_patterns: Double,
    progress: Callable[[str], None],
) -> _Piece:
    """Trace a piece, or find it on disk."""
    from scipy.sparse import csr_array

    try:
        bundle = open_arrays(path)
        return _Piece(first, last, path, bundle.read("forth"), bundle.read("back"))
    except (StoreError, IntegrityError):
        pass
    halves = [trace(half, first, last) for half in (0, 1)]
    forth = np.stack([np.einsum("iok,po->pik", half, patterns) for half in halves])
    back = np.stack(
        [np.einsum("iok,pi->pok", half, own_patterns[:, first:last]) for half in halves]
    )
    mean = ((halves[0] + halves[1]) / 2).astype(np.float32)
    matrices = [csr_array(mean[..., channel]) for channel in range(3)]
    _write(path, matrices, {"forth": forth, "back": back})
    progress(f"{path.stem}: up to ray {last}")
    return _Piece(first, last, path, forth, back)


def _total(
    first: int, last: int, own: list[_Piece], across: list[_Piece]
) -> list[csr_array[np.float32]]:
    """Rows of the matrix: those traced by row, and what was traced by column of them."""
    from scipy.sparse import hstack

    parts = [_read(piece.path) for piece in own if piece.first == first]
    if across:
        slices = [[each[:, first:last].T for each in _read(piece.path)] for piece in across]
        parts.append([hstack(blocks).tocsr() for blocks in zip(*slices, strict=True)])
    return [sum(each[1:], each[0]).tocsr() for each in zip(*parts, strict=True)]


def _mean(one: csr_array[np.float32], other: csr_array[np.float32]) -> csr_array[np.float32]:
    return ((one + other) * np.float32(0.5)).tocsr()


def _write(
    path: Path,
    matrices: list[csr_array[np.float32]],
    arrays: dict[str, Double],
) -> None:
    """Write matrices, one a channel, with other arrays."""
    named: dict[str, NDArray[Any]] = dict(arrays)
    for channel, matrix in enumerate(matrices):
        named[f"values_{channel}"] = matrix.data.astype(np.float32)
        named[f"columns_{channel}"] = matrix.indices.astype(np.int32)
        named[f"starts_{channel}"] = matrix.indptr.astype(np.int64)
    write_arrays(path, named, {"others": matrices[0].shape[1]})


def _read(path: Path) -> list[csr_array[np.float32]]:
    """Read matrices, one a channel."""
    from scipy.sparse import csr_array

    bundle = open_arrays(path)
    matrices = []
    for channel in range(3):
        starts = bundle.read(f"starts_{channel}")
        parts = bundle.read(f"values_{channel}"), bundle.read(f"columns_{channel}"), starts
        matrices.append(csr_array(parts, shape=(len(starts) - 1, bundle.attributes["others"])))
    return matrices


def _probes(views: Views) -> Double:
    """Return the pictures that tell the noise: half lit, random, a small spot; (3, rays)."""
    height, width = views.shape
    probes = np.zeros((len(_PROBES), len(views.views), height, width))
    probes[0, ..., : width // 2] = 1
    probes[1] = generator(_PROBE_SEED).random(probes.shape[1:]) < 0.5
    probes[2, ..., height // 3 : height // 3 + _SPOT, width // 3 : width // 3 + _SPOT] = 1
    return probes.reshape(len(_PROBES), -1)


def _pictures(own: list[_Piece], across: list[_Piece], rays: int) -> Double:
    """Pictures (2, P, rays, 3) of the probes by either half."""
    pictures = np.zeros((2, len(_PROBES), rays, 3))
    for piece in own:
        pictures[:, :, piece.first : piece.last] += piece.forth
    for piece in across:
        pictures += piece.back
    return pictures


def _noise(halves: Double, unlit: NDArray[np.bool_]) -> dict[str, dict[str, float]]:
    """Return the standard errors of the mean of two halves, relative, of each probe."""
    noise = {}
    for index, name in enumerate(_PROBES):
        difference, total = halves[0, index] - halves[1, index], halves[:, index].sum(axis=0)
        parts = {"whole": slice(None), "unlit": unlit[index]}
        noise[name] = {part: _relative(difference[at], total[at]) for part, at in parts.items()}
    return noise


def _relative(difference: Double, total: Double) -> float:
    """Return how long a difference is beside a total; 0 where there is no light."""
    length = float(np.linalg.norm(total))
    return float(np.linalg.norm(difference)) / length if length else 0.0
