"""Recording a scene's transport matrix once, in pieces, on disk.

The matrix is traced twice, with other random numbers; the mean is kept, and what the halves differ
by tells its noise. Pieces are rows that were traced from the camera and, for caustics, columns that
were traced from the projector. They are written as they are done, so that a recording that was
stopped goes on. A product with the matrix goes through them all once. On a coaxial rig it is that
with ``(T + T^T) / 2``: light goes either way alike (2.10), so this is nearer to the truth by a
square root of two.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rfpipe.errors import InputError, IntegrityError, LockedError, StoreError
from rfpipe.mitsuba.variant import variant_versions
from rfpipe.mitsuba.views import Side
from rfpipe.mitsuba.world import Light
from rfpipe.provenance import versions
from rfpipe.steps import step, steps
from rfpipe.store import open_arrays, write_arrays
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest

Double = NDArray[np.float64]

_DENSE_BYTES = 192 * 2**20  # of sums that are traced at a time
_PIECE_BYTES = 192 * 2**20  # of entries, before compression
_MANIFEST = "matrix.json"
_WAIT_SECONDS = 1.0
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear sRGB (ITU-R BT.709)


class Piece(NamedTuple):
    """Some rows of a recorded matrix, or some columns, in memory.

    Attributes
    ----------
    by_row : bool
        Whether they are rows, of camera pixels, or columns, of projector pixels.
    first, last : int
        The first pixel, and the one after the last.
    entries : tuple of csr_array
        A matrix a channel, float32, (last - first, pixels of the other side).
    """

    by_row: bool
    first: int
    last: int
    entries: tuple[Any, ...]

    def add_product(self, weights: Double, share: float, by_row: bool, out: Double) -> None:
        """Add the share of its product with weights (N, b) to radiance (M, b, C).

        Its entries count as rows, or as columns, of the matrix.
        """
        for channel, matrix in enumerate(self.entries):
            if by_row:
                out[self.first : self.last, :, channel] += share * (matrix @ weights)
            else:
                out[..., channel] += share * (matrix.T @ weights[self.first : self.last])


@dataclass(frozen=True)
class Recording:
    """A recorded matrix on disk, and what is known of its noise.

    Attributes
    ----------
    folder : Path
    pieces : tuple of (str, int, int)
        Of each piece: ``rows`` or ``columns``, its first pixel, and the one after its last.
    coaxial : bool
        Whether the matrix is the mean of what was traced and its transpose.
    noise : dict of str to dict
        Of the picture ``half_lit``: the standard error of radiance, relative to the picture's norm,
        over the `whole` and where no direct light falls (`unlit`).
    scale : float
        What entries are multiplied by.
    versions : dict of str to str
        Of all that it was made with.
    """

    folder: Path
    pieces: tuple[tuple[str, int, int], ...]
    coaxial: bool
    noise: dict[str, dict[str, float]]
    scale: float
    versions: dict[str, str]

    def read(self, channels: int) -> list[Piece]:
        """Read all pieces, with the scale; of one channel, their luminance."""
        return [self._piece(*piece, channels) for piece in self.pieces]

    def _piece(self, kind: str, first: int, last: int, channels: int) -> Piece:
        bundle = open_arrays(_place(self.folder, kind, first))
        values = bundle.read("values")
        if channels == 1:
            values = _LUMINANCE @ values.reshape(3, -1)
        values = values.reshape(channels, -1) * np.float32(self.scale)
        shared = bundle.read("columns"), bundle.read("starts")
        shape = last - first, bundle.attributes["others"]
        return Piece(
            kind == "rows",
            first,
            last,
            tuple(csr_array((each, *shared), shape=shape) for each in values),
        )


def product(pieces: list[Piece], coaxial: bool, weights: Double, rays: int) -> Double:
    """Return radiance (rays, b, C) of the recorded matrix under weights (N, b)."""
    out = np.zeros((rays, weights.shape[1], len(pieces[0].entries)))
    for piece, share, by_row in _terms(pieces, coaxial):
        piece.add_product(weights, share, by_row, out)
    return out


def dense(pieces: list[Piece], coaxial: bool, channel: int, shape: tuple[int, int]) -> Double:
    """Return one channel of the recorded matrix, of a shape (M, N)."""
    out = np.zeros(shape)
    for piece, share, by_row in _terms(pieces, coaxial):
        block = share * piece.entries[channel].toarray().astype(np.float64)
        own = out if by_row else out.T
        own[piece.first : piece.last] += block
    return out


def _terms(pieces: list[Piece], coaxial: bool) -> Iterator[tuple[Piece, float, bool]]:
    """Yield what the matrix is the sum of: shares of pieces, as rows or as columns."""
    for piece in pieces:
        if coaxial:
            yield piece, 0.5, True
            yield piece, 0.5, False
        else:
            yield piece, 1.0, piece.by_row


def is_recorded(folder: Path) -> bool:
    """Whether a folder holds a complete recording."""
    return (folder / _MANIFEST).exists()


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
    manifest, lock = folder / _MANIFEST, StoreLock(folder / "recording")
    while not manifest.exists():
        try:
            lock.acquire()
        except LockedError:
            time.sleep(_WAIT_SECONDS)
            continue
        with lock:
            if not manifest.exists():
                facts = _record(scene(), camera, projector, light, folder, coaxial)
                write_manifest(manifest, facts)
    facts = read_manifest(manifest)
    pieces = tuple((kind, first, last) for kind, first, last in facts["pieces"])
    told = (facts[name] for name in ("coaxial", "noise", "scale", "versions"))
    return Recording(folder, pieces, *told)


def _record(
    scene: Any, camera: Side, projector: Side, light: Light, folder: Path, coaxial: bool
) -> dict[str, Any]:
    """Trace the pieces that the folder lacks; return the facts for its manifest."""
    from rfpipe.mitsuba.rendering import brightness
    from rfpipe.mitsuba.tracing import Tracer

    tracer = Tracer(scene, camera, projector, light)
    coaxial = coaxial and tracer.is_whole
    half_lit = np.zeros((len(projector.pinholes), *projector.shape))
    half_lit[..., : projector.shape[1] // 2] = 1
    pattern = half_lit.reshape(-1, 1)
    pieces = [("rows", *run) for run in _cut(camera.rays, projector.rays, light.samples)]
    if light.caustics:
        runs = _cut(projector.rays, camera.rays, light.samples)
        pieces += [("columns", *run) for run in runs]
    entries, unlit = 0, []
    halves = np.zeros((2, camera.rays, 3))
    with steps("recording light", len(pieces)):
        for kind, first, last in pieces:
            path = _place(folder, kind, first)
            try:
                bundle = open_arrays(path)
            except (StoreError, IntegrityError):
                arrays = _traced(tracer, kind, first, last, pattern, coaxial)
                write_arrays(path, arrays, {"others": tracer.others(kind)})
                bundle = open_arrays(path)
            entries += bundle.shape("columns")[0]
            halves += bundle.read("half_lit")
            unlit.append(bundle.read("unlit"))
            step()
    if not entries:
        raise InputError(
            "no light comes back to the camera: nothing that it sees is lit by the projector; turn "
            "them towards the same part of the scene, and look whether one stands within a body"
        )
    one, other = halves
    dark = np.concatenate(unlit)
    noise = {
        "whole": _relative(one - other, one + other),
        "unlit": _relative((one - other)[dark], (one + other)[dark]),
    }
    return {
        "pieces": pieces,
        "coaxial": coaxial,
        "noise": {"half_lit": noise},
        "scale": brightness(scene, projector),
        "light": light.describe(),
        "versions": {**versions(), **variant_versions()},
    }


def _place(folder: Path, kind: str, first: int) -> Path:
    """Where a piece is."""
    return folder / f"{kind}_{first:08d}.zarr"


def _cut(count: int, others: int, samples: int) -> list[tuple[int, int]]:
    """Cut rows or columns into pieces that fit into memory; a path adds an entry or two.

    Returns the first of each, and the one after its last.
    """
    length = max(1, _PIECE_BYTES // (16 * min(others, 2 * samples)))
    return [(first, min(first + length, count)) for first in range(0, count, length)]


def _traced(
    tracer: Any, kind: str, first: int, last: int, pattern: Double, coaxial: bool
) -> dict[str, NDArray[Any]]:
    """Trace the rows or columns of a piece: its entries, and what the halves make of a pattern.

    Returns
    -------
    dict of ndarray
        ``values`` (3, entries), ``columns`` (entries,), ``starts`` (rows + 1,), ``half_lit``
        (2, M, 3) of both halves, ``unlit`` (rows, 3): where no direct light falls; none of columns.
    """
    trace, others = getattr(tracer, kind), tracer.others(kind)
    length = max(1, _DENSE_BYTES // (others * 3 * 8))
    parts, unlit = [], []
    seen = tracer.others("columns")
    half_lit = np.zeros((2, seen, 3), np.float32)
    for start in range(first, last, length):
        end = min(start + length, last)
        traced = [trace(half, start, end) for half in (0, 1)]
        rows, columns = np.nonzero((traced[0] + traced[1]).any(axis=2))
        starts = np.searchsorted(rows, np.arange(end - start + 1))
        values = [np.moveaxis(half[rows, columns], 1, 0) for half in traced]
        for half, own in enumerate(values):
            shape = end - start, others
            entries = tuple(csr_array((each, columns, starts), shape=shape) for each in own)
            piece = Piece(kind == "rows", start, end, entries)
            half_lit[half] += product([piece], coaxial, pattern, seen)[:, 0]
        parts.append(((values[0] + values[1]) / 2, columns, np.diff(starts)))
        if kind == "rows":
            direct = tracer.direct(start, end)
            unlit.append(np.einsum("iok,o->ik", direct, pattern[:, 0]) == 0)
    mean, columns, counts = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    return {
        "values": mean.astype(np.float32).ravel(),
        "columns": columns.astype(np.int32),
        "starts": np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        "half_lit": half_lit,
        "unlit": np.concatenate(unlit) if unlit else np.zeros((0, 3), bool),
    }


def _relative(difference: Double, total: Double) -> float:
    """Length of a difference beside a total; 0 where there is no light."""
    length = float(np.linalg.norm(total))
    return float(np.linalg.norm(difference)) / length if length else 0.0
