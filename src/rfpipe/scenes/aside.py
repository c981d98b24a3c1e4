"""Light between diffuse surfaces, camera and projector apart [thesis 2.2, Fig. 3.10].

The camera's pixel i covers a piece of surface of area A_i around the point that its central ray
meets, the projector's pixel j one of area B_j. With r the albedo at a place x of a surface, and all
times s, the mean of B and the strength of the light:

- Direct light. A projector pixel spreads its light evenly over its part of the picture, and a
  camera pixel sees the mean over its own: ``T_ij = sum over x in i of r(x) [x in j] / (K B_j)``,
  over the K parts into which i is cut, those alone that nothing hides from the projector. By the
  parts of j the same is ``sum over x in j of r(x) [x in i] / (K A_i)``; the mean of the two is
  taken.
- Indirect light is that of `rfpipe.scenes.radiosity`, from the projector's points j to the camera's
  i: ``r_i G_ij r_j + r_i (sum over k of G_ik r_k a_k G_kj) r_j``. The points k in between are those
  of both pictures. What both see counts by half in either: ``a_i = A_i (1 - v_i / 2)``, with v_i
  the share of i that the projector sees; likewise ``a_j = B_j (1 - v_j / 2)``.

When the two change places, T becomes ``T^T`` but for s (Helmholtz' reciprocity). Where they stand
at one place, v is 1, A is B, and T the coaxial matrix.

A part of a pixel stands for a box on the other's picture, as wide as the outline of the piece of
surface that it covers has there (of the same standard deviation), and is shared out between the
pixels that the box overlaps. Points in place of boxes would make ripples where the two pictures are
about as fine. A box knows nothing of outlines: light that falls close beside one reaches over it by
half a box.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.radiosity import RadiosityScene, Rays
from rfpipe.scenes.sight import Pinhole, Points, Sight, least_squared, overlaps, sight_of
from rfpipe.scenes.surfaces import Hider, Occluder, Surface, is_hidden

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Double = NDArray[np.float64]
Albedo = Callable[[Double, NDArray[np.int64]], Double]

_PARTS = 4  # of a pixel along either side
_WIDEST = 8  # pixels that a box counts as wide at most, for the memory's sake
_BOXES_AT_A_TIME = 2**16


def aside_scene(
    surfaces: Sequence[Surface],
    camera: Pinhole,
    projector: Pinhole,
    albedo: Albedo,
    *,
    occluders: Sequence[Occluder] = (),
    contrast: float = math.inf,
    **options: Any,
) -> RadiosityScene:
    """Build a scene seen by a camera and lit by a projector that stands elsewhere.

    Rays that meet no surface carry no light.

    Parameters
    ----------
    surfaces, camera, projector, occluders
        What is there, and the two pinholes; occluders block the view of either, too.
    albedo
        Albedo in [0, 1), float64 (n, C), of places float64 (n, 3) on surfaces int64 (n,), which
        are numbered as in `surfaces`.
    contrast
        The light is dimmed so that no pixel of the projector has more of it, per area, than this
        times what one of mean area has at full strength.
    **options
        The bounces and name of a `RadiosityScene`.

    Raises
    ------
    InputError
        If a pinhole stands behind a plane or within the sphere, or an option is out of range.
    """
    from scipy.sparse import csr_array, eye_array

    view, lit = (
        _side(one, other, tuple(surfaces), tuple(occluders), albedo)
        for one, other in ((camera, projector), (projector, camera))
    )
    mean = float((view.seen_areas.mean() + lit.seen_areas.mean()) / 2)
    joined = [np.concatenate(pair) for pair in zip(view[:4], lit[:4], strict=True)]
    surface, positions, areas, values = joined
    points = Points(tuple(surfaces), surface, positions, areas, least_squared(surfaces, mean))
    scale = float(min(lit.seen_areas.mean(), contrast * lit.seen_areas.min()))
    direct = [
        csr_array(there.multiply(1 / lit.areas) + back.T.multiply(1 / view.areas[:, None]))
        * (scale / 2)
        for there, back in zip(view.common, lit.common, strict=True)
    ]
    count, rays = len(points.areas), len(view.areas)
    return RadiosityScene(
        points,
        values,
        occluders=occluders,
        scale=scale,
        rays=Rays(
            camera.shape,
            projector.shape,
            eye_array(rays, count, format="csr"),
            eye_array(count, count - rays, k=-rays, format="csr"),
            direct,
        ),
        about={"camera": asdict(camera), "projector": asdict(projector), "parts": _PARTS},
        **options,
    )


class _Side(NamedTuple):
    """What one pinhole sees of the surfaces, pixel by pixel, n in all.

    `surface` (n,), -1 of none; `positions` (n, 3); `bounce_areas`, what they count in light that
    goes on; `albedo` (n, C), 0 of none and of an occluder; `areas` (n,) covered there, 1 of none;
    `common`, sums over x in the module's first equation, (n, the other's pixels), one a channel.
    """

    surface: NDArray[np.int64]
    positions: Double
    bounce_areas: Double
    albedo: Double
    areas: Double
    common: list[csr_array[np.float64]]

    @property
    def seen_areas(self) -> Double:
        """The areas of the pixels that see a surface; 1 of a pinhole that sees none."""
        areas = self.areas[self.surface >= 0]
        return areas if len(areas) else np.ones(1)


def _side(
    one: Pinhole,
    other: Pinhole,
    surfaces: tuple[Surface, ...],
    occluders: tuple[Occluder, ...],
    albedo: Albedo,
) -> _Side:
    """Look at the surfaces through one pinhole, and find what it has in common with the other."""
    from scipy.sparse import csr_array, diags_array

    _require_inside(one.origin, surfaces)
    sight, parts = sight_of(one, surfaces), sight_of(one, surfaces, _PARTS)
    things = tuple(each for each in surfaces if isinstance(each, Hider))
    clear = _is_clear(one.origin, sight, occluders)
    both = _is_clear(one.origin, parts, occluders)
    both &= _is_clear(other.origin, parts, (*things, *occluders))
    shared = _shares(parts, other, both)
    count, each = len(sight.surface), _PARTS**2
    sums = csr_array(
        (np.full(count * each, 1 / each), np.arange(count * each), np.arange(count + 1) * each)
    )
    reflected = albedo(parts.positions, parts.surface)
    areas = np.where(sight.surface >= 0, sight.areas, 1)
    visible = np.asarray((sums @ shared).sum(axis=1))
    return _Side(
        sight.surface,
        sight.positions,
        areas * (1 - visible / 2),
        albedo(sight.positions, sight.surface) * clear[:, None],
        areas,
        [(sums @ diags_array(r) @ shared).tocsr() for r in reflected.T],
    )


def _require_inside(origin: Double, surfaces: Sequence[Surface]) -> None:
    """Raise InputError where a pinhole stands behind a plane, or within a block or a sphere."""
    for name in dict.fromkeys(surface.name for surface in surfaces):
        # of a block it is enough to stand before one face
        if not any(each.heights(origin) > 0 for each in surfaces if each.name == name):
            raise InputError(
                f"projector at ({', '.join(f'{x:g}' for x in origin)}): stands behind the surface "
                f"{name}; give it a position in the room, on the camera's side"
            )


def _is_clear(origin: Double, sight: Sight, hiders: Sequence[Hider]) -> NDArray[np.bool_]:
    """Tell which points of surfaces a place has in view: their fronts, with nothing before them."""
    towards = ((origin - sight.positions) * sight.normals).sum(1) > 0
    hidden = is_hidden(origin, sight.positions, hiders)
    return np.asarray((sight.surface >= 0) & towards & ~hidden)


def _shares(sight: Sight, other: Pinhole, clear: NDArray[np.bool_]) -> csr_array[np.float64]:
    """Share the parts of one pinhole's pixels, n in all, out between the other's pixels.

    Rows add up to 1, to less at the edge of the other's picture, to 0 where it isn't clear.
    """
    from scipy.sparse import csr_array

    chosen = np.flatnonzero(clear)
    place = other.project(sight.positions[chosen])
    sides = other.project_moves(sight.positions[chosen], sight.moves(chosen))
    width = np.sqrt((sides**2).sum(axis=1))
    ahead = np.isfinite(place).all(axis=1)
    chosen, place, width = chosen[ahead], place[ahead], np.minimum(width[ahead], _WIDEST)
    height, across = other.shape
    entries = [(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))]
    for first in range(0, len(chosen), _BOXES_AT_A_TIME):
        some = slice(first, first + _BOXES_AT_A_TIME)
        box, row, column, share = overlaps(place[some], width[some])
        within = (row >= 0) & (row < height) & (column >= 0) & (column < across)
        pixel = row * across + column
        entries.append((share[within], chosen[some][box[within]], pixel[within]))
    share, row, pixel = (np.concatenate(each) for each in zip(*entries, strict=True))
    return csr_array((share, (row, pixel)), shape=(len(clear), height * across))
