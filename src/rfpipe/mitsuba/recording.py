"""Recording of a scene's transport matrix on disk, in pieces.

The matrix is traced twice with half of the samples each; the mean is stored, and the difference of
the halves estimates its noise. Pieces are rows, traced from the camera, and for caustics columns,
traced from the projector. They are written one by one, so an interrupted recording continues. On a
coaxial rig, where ``T = T^T`` (2.10), products use ``(T + T^T) / 2``, whose noise is smaller by a
factor of the square root of two.
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

from rfpipe.array_types import Double
from rfpipe.errors import InputError, IntegrityError, LockedError, StoreError
from rfpipe.mitsuba.variant import variant_versions
from rfpipe.mitsuba.views import Side
from rfpipe.mitsuba.world import TracingOptions
from rfpipe.provenance import versions
from rfpipe.ranges import ranges
from rfpipe.steps import step, steps
from rfpipe.store import open_arrays, write_arrays
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import read_manifest, write_manifest

_DENSE_BYTES = 192 * 2**20  # of sums traced at a time
_PIECE_BYTES = 192 * 2**20  # of entries, before compression
_MANIFEST = "matrix.json"
_WAIT_SECONDS = 1.0
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear sRGB (ITU-R BT.709)


class Piece(NamedTuple):
    """Consecutive rows or columns of a recorded matrix, in memory.

    Attributes
    ----------
    by_row : bool
        True for rows, of camera pixels; False for columns, of projector pixels.
    first, last : int
        Pixels [first, last).
    entries : tuple of csr_array
        A matrix per channel, float32, (last - first, pixels of the opposite side).
    """

    by_row: bool
    first: int
    last: int
    entries: tuple[Any, ...]

    def add_product(self, weights: Double, share: float, by_row: bool, out: Double) -> None:
        """Add the product with weights (N, b), times `share`, to radiance (M, b, C).

        `by_row` uses the entries as rows of the matrix, else as columns.
        """
        for channel, matrix in enumerate(self.entries):
            if by_row:
                out[self.first : self.last, :, channel] += share * (matrix @ weights)
            else:
                out[..., channel] += share * (matrix.T @ weights[self.first : self.last])


@dataclass(frozen=True)
class Recording:
    """A recorded matrix on disk, with its noise.

    Attributes
    ----------
    folder : Path
    pieces : tuple of (str, int, int)
        ``rows`` or ``columns``, first pixel and last pixel plus one, of each piece.
    coaxial : bool
        True if the matrix is the mean of the traced matrix and its transpose.
    noise : dict of str to dict
        For the picture ``half_lit``: standard error of radiance relative to the picture's norm, of
        the `whole` picture and of pixels without direct light (`unlit`).
    scale : float
        Factor for all entries.
    versions : dict of str to str
        Versions of the software used.
    """

    folder: Path
    pieces: tuple[tuple[str, int, int], ...]
    coaxial: bool
    noise: dict[str, dict[str, float]]
    scale: float
    versions: dict[str, str]

    def read(self, shape: tuple[int, int], channels: int) -> list[Piece]:
        """Read all scaled pieces of a matrix of this shape (M, N).

        For one channel, entries are luminances.
        """
        lengths = {"rows": shape[1], "columns": shape[0]}
        return [
            self._piece(kind, first, (last - first, lengths[kind]), channels)
            for kind, first, last in self.pieces
        ]

    def _piece(self, kind: str, first: int, shape: tuple[int, int], channels: int) -> Piece:
        bundle = open_arrays(_piece_path(self.folder, kind, first))
        values = bundle.read("values")
        if channels == 1:
            values = _LUMINANCE @ values.reshape(3, -1)
        values = values.reshape(channels, -1) * np.float32(self.scale)
        pattern = bundle.read("columns"), bundle.read("starts")
        entries = tuple(csr_array((channel, *pattern), shape=shape) for channel in values)
        return Piece(kind == "rows", first, first + shape[0], entries)


def product(pieces: list[Piece], coaxial: bool, weights: Double, rays: int) -> Double:
    """Multiply the recorded matrix by weights (N, b): radiance (rays, b, C)."""
    out = np.zeros((rays, weights.shape[1], len(pieces[0].entries)))
    for piece, share, by_row in _terms(pieces, coaxial):
        piece.add_product(weights, share, by_row, out)
    return out


def dense(pieces: list[Piece], coaxial: bool, channel: int, shape: tuple[int, int]) -> Double:
    """Build one channel of the recorded matrix, of a shape (M, N), as a dense array."""
    out = np.zeros(shape)
    for piece, share, by_row in _terms(pieces, coaxial):
        block = share * piece.entries[channel].toarray().astype(np.float64)
        rows = out if by_row else out.T
        rows[piece.first : piece.last] += block
    return out


def _terms(pieces: list[Piece], coaxial: bool) -> Iterator[tuple[Piece, float, bool]]:
    """Yield the terms of the matrix: pieces, factors, and True for rows, False for columns."""
    for piece in pieces:
        if coaxial:
            yield piece, 0.5, True
            yield piece, 0.5, False
        else:
            yield piece, 1.0, piece.by_row


def is_recorded(folder: Path) -> bool:
    """Test whether a folder has a complete recording."""
    return (folder / _MANIFEST).exists()


def record(
    scene: Callable[[], Any],
    camera: Side,
    projector: Side,
    light: TracingOptions,
    folder: Path,
    *,
    coaxial: bool,
) -> Recording:
    """Record the transport of the scene that `scene` returns, unless the folder has it already.

    Waits while another process records it.

    Raises
    ------
    InputError
        When no light reaches the camera.
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
        try:
            if not manifest.exists():
                facts = _record(scene(), camera, projector, light, folder, coaxial)
                write_manifest(manifest, facts)
        finally:
            lock.release()
    facts = read_manifest(manifest)
    pieces = tuple((kind, first, last) for kind, first, last in facts["pieces"])
    properties = (facts[name] for name in ("coaxial", "noise", "scale", "versions"))
    return Recording(folder, pieces, *properties)


def _record(
    scene: Any, camera: Side, projector: Side, light: TracingOptions, folder: Path, coaxial: bool
) -> dict[str, Any]:
    """Trace the pieces that the folder lacks; return the facts for its manifest."""
    from rfpipe.mitsuba.rendering import brightness
    from rfpipe.mitsuba.tracing import Tracer

    tracer = Tracer(scene, camera, projector, light)
    coaxial = coaxial and tracer.is_symmetric
    pieces = [("rows", *part) for part in _cut(camera.rays, projector.rays, light.samples)]
    if light.caustics:
        parts = _cut(projector.rays, camera.rays, light.samples)
        pieces += [("columns", *part) for part in parts]
    half_lit = np.zeros((len(projector.pinholes), *projector.shape))
    half_lit[..., : projector.shape[1] // 2] = 1
    noise = _trace_pieces(tracer, pieces, folder, half_lit.reshape(-1, 1), coaxial=coaxial)
    return {
        "pieces": pieces,
        "coaxial": coaxial,
        "noise": {"half_lit": noise},
        "scale": brightness(scene, projector),
        "light": light.describe(),
        "versions": {**versions(), **variant_versions()},
    }


def _trace_pieces(
    tracer: Any,
    pieces: list[tuple[str, int, int]],
    folder: Path,
    pattern: Double,
    *,
    coaxial: bool,
) -> dict[str, float]:
    """Write all pieces; return the relative noise of the picture of a pattern (N, 1)."""
    entries, unlit, halves = 0, [], np.zeros((2, tracer.length("columns"), 3))
    with steps("recording light", len(pieces)):
        for kind, first, last in pieces:
            path = _piece_path(folder, kind, first)
            try:
                bundle = open_arrays(path)
            except (StoreError, IntegrityError):
                write_arrays(path, _trace_piece(tracer, kind, first, last, pattern, coaxial), {})
                bundle = open_arrays(path)
            entries += bundle.shape("columns")[0]
            halves += bundle.read("half_lit")
            unlit.append(bundle.read("unlit"))
            step()
    if not entries:
        raise InputError(
            "no light reaches the camera: the projector lights nothing that the camera sees; turn "
            "them towards the same part of the scene, and check that neither is within a body"
        )
    dark = np.concatenate(unlit)
    difference, total = halves[0] - halves[1], halves[0] + halves[1]
    return {
        "whole": _relative(difference, total),
        "unlit": _relative(difference[dark], total[dark]),
    }


def _piece_path(folder: Path, kind: str, first: int) -> Path:
    """Path of the arrays of a piece."""
    return folder / f"{kind}_{first:08d}.zarr"


def _cut(count: int, length: int, samples: int) -> list[tuple[int, int]]:
    """Divide `count` rows or columns into pieces [first, last) that fit into memory.

    A row has at most `length` entries, and about two per path.
    """
    size = max(1, _PIECE_BYTES // (16 * min(length, 2 * samples)))
    return ranges(count, size)


def _trace_piece(
    tracer: Any, kind: str, first: int, last: int, pattern: Double, coaxial: bool
) -> dict[str, NDArray[Any]]:
    """Trace the rows or columns of a piece.

    Returns
    -------
    dict of ndarray
        ``values`` (3, entries), ``columns`` (entries,), ``starts`` (rows + 1,); ``half_lit``
        (2, M, 3): products of both halves with the pattern; ``unlit`` (rows, 3): True where no
        direct light falls, empty for columns.
    """
    trace = tracer.rows if kind == "rows" else tracer.columns
    length, camera_rays = tracer.length(kind), tracer.length("columns")
    size = max(1, _DENSE_BYTES // (length * 3 * 8))
    parts, unlit = [], []
    half_lit = np.zeros((2, camera_rays, 3), np.float32)
    for start in range(first, last, size):
        end = min(start + size, last)
        traced = [trace(half, start, end) for half in (0, 1)]
        rows, columns = np.nonzero((traced[0] + traced[1]).any(axis=2))
        starts = np.searchsorted(rows, np.arange(end - start + 1))
        values = [np.moveaxis(half[rows, columns], 1, 0) for half in traced]
        for half, colours in enumerate(values):
            shape = end - start, length
            entries = tuple(csr_array((c, columns, starts), shape=shape) for c in colours)
            piece = Piece(kind == "rows", start, end, entries)
            half_lit[half] += product([piece], coaxial, pattern, camera_rays)[:, 0]
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
    """Norm of a difference relative to that of a total; 0 without light."""
    norm = float(np.linalg.norm(total))
    return float(np.linalg.norm(difference)) / norm if norm else 0.0
