"""What the pixels of two pinholes have in common, and what hides surfaces from a pinhole.

A pixel is cut into parts. Each part stands for a box on the other's picture, as wide as the outline
of the piece of surface that it covers has there (of the same standard deviation), and is shared out
between the pixels that the box overlaps. Points in place of boxes would make ripples where the two
pictures are about as fine. A box knows nothing of outlines: light that falls close beside one
reaches over it by half a box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.geometry import Rectangle, Sight, Sphere, Surface
from rfpipe.scenes.occluders import Occluder, blocked
from rfpipe.scenes.pinhole import Pinhole
from rfpipe.scenes.spheres import hidden

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["is_clear", "require_inside", "shares"]

Double = NDArray[np.float64]

_ROUNDING = 1e-9  # share of a box below which it overlaps a pixel by rounding alone
_WIDEST = 8  # pixels that a box counts as wide at most, for the memory's sake
_BOXES_AT_A_TIME = 2**16


def require_inside(origin: Double, surfaces: Sequence[Surface]) -> None:
    """Raise InputError where a pinhole stands behind a plane, or within a block or a sphere."""
    for name in dict.fromkeys(surface.name for surface in surfaces):
        # of a block it is enough to stand before one face
        if not any(each.heights(origin) > 0 for each in surfaces if each.name == name):
            raise InputError(
                f"projector at ({', '.join(f'{x:g}' for x in origin)}): stands behind the surface "
                f"{name}; give it a position in the room, on the camera's side"
            )


def is_clear(
    origin: Double, sight: Sight, surfaces: Sequence[Surface], occluders: Sequence[Occluder]
) -> NDArray[np.bool_]:
    """Tell which points of surfaces a pinhole has in view: their fronts, with nothing before them.

    Parameters
    ----------
    origin
        The pinhole's position, float64 (3,).
    sight
        The n points.
    surfaces, occluders
        All there are in the room. Planes, which bound it, hide nothing that lies before them.

    Returns
    -------
    ndarray of bool, (n,)
    """
    facing = ((origin - sight.positions) * sight.normals).sum(1) > 0
    clear: NDArray[np.bool_] = (sight.surface >= 0) & facing
    for surface in surfaces:
        if isinstance(surface, Sphere):
            clear &= ~hidden(surface, origin[None], sight.positions)[0]
    rectangles = [each.occluder for each in surfaces if isinstance(each, Rectangle)]
    for occluder in (*rectangles, *occluders):
        here, there = occluder.coordinates(origin), occluder.coordinates(sight.positions)
        clear &= ~blocked(here, there)
    return clear


def shares(sight: Sight, other: Pinhole, clear: NDArray[np.bool_]) -> csr_array[np.float64]:
    """Share the parts of one pinhole's pixels out between the other's pixels.

    Parameters
    ----------
    sight
        Where the parts of the one meet surfaces, n in all.
    other
        The other pinhole.
    clear
        bool (n,): the parts that both have in view.

    Returns
    -------
    csr_array of float64, (n, pixels of the other)
        Rows add up to 1, to less at the edge of the other's picture, to 0 where it isn't clear.
    """
    from scipy.sparse import csr_array

    chosen = np.flatnonzero(clear)
    place = other.project(sight.positions[chosen])
    sides = other.project_moves(sight.positions[chosen], sight.moves(chosen))
    width = np.sqrt((sides**2).sum(axis=1))
    ahead = np.isfinite(place).all(axis=1)
    chosen, place, width = chosen[ahead], place[ahead], np.minimum(width[ahead], _WIDEST)
    found = [(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))]
    for first in range(0, len(chosen), _BOXES_AT_A_TIME):
        some = slice(first, first + _BOXES_AT_A_TIME)
        share, box, pixel = _overlaps(place[some], width[some], other.shape)
        found.append((share, chosen[some][box], pixel))
    share, row, pixel = (np.concatenate(each) for each in zip(*found, strict=True))
    return csr_array((share, (row, pixel)), shape=(len(clear), math.prod(other.shape)))


def _overlaps(
    place: Double, width: Double, shape: tuple[int, int]
) -> tuple[Double, NDArray[np.int64], NDArray[np.int64]]:
    """Share boxes out between the pixels of a picture: the shares, their boxes and pixels."""
    low = place - width / 2
    first = np.floor(low).astype(np.int64)
    shares, cells = [], []
    for axis in (0, 1):
        count = int(np.ceil(width[:, axis].max())) + 1
        cell = first[:, axis, None] + np.arange(count)
        start, end = low[:, axis, None], (low + width)[:, axis, None]
        overlap = np.minimum(end, cell + 1) - np.maximum(start, cell)
        shares.append(np.maximum(overlap, 0) / width[:, axis, None])
        shares[-1][(cell < 0) | (cell >= shape[axis])] = 0
        cells.append(cell)
    share = shares[0][:, :, None] * shares[1][:, None]
    box, row, column = np.nonzero(share > _ROUNDING)
    pixel = cells[0][box, row] * shape[1] + cells[1][box, column]
    return share[box, row, column], box, pixel
