"""Light transport between diffuse surfaces, with separate camera and projector [thesis 2.2].

Camera pixel i covers a surface area A_i around the point that its central ray hits, and projector
pixel j an area B_j. With the albedo r(x) at a surface point x, and up to a common scale s, the mean
of B times the strength of the light:

- Direct light. A projector pixel spreads its light evenly over its square of the picture, and a
  camera pixel averages over its own: ``T_ij = sum over x in i of r(x) [x in j] / (K B_j)``, over
  the K parts of pixel i that are visible from the projector. By the parts of j, the same is
  ``sum over x in j of r(x) [x in i] / (K A_i)``. The mean of both is used.
- Indirect light, as in `rfpipe.scenes.radiosity`, from the projector's points j to the camera's i:
  ``r_i G_ij r_j + r_i (sum over k of G_ik r_k a_k G_kj) r_j``. Intermediate points k are those of
  both pictures; surfaces in both pictures count half in each: ``a_i = A_i (1 - v_i / 2)``, where
  v_i is the fraction of i that the projector sees, and likewise ``a_j = B_j (1 - v_j / 2)``.

Exchanging the two transposes T, except for s (Helmholtz reciprocity). If they coincide, v = 1,
A = B, and T is the coaxial matrix.

A part of a pixel is represented by a box in the picture of the opposite side, with the standard
deviation of the outline of its surface area there, and distributed to the pixels that the box
overlaps. Points instead of boxes would cause aliasing where both pictures have similar resolution.
Boxes ignore occlusion boundaries, so light next to one may leak over it by half a box [Fig. 3.10].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.errors import InputError
from rfpipe.scenes.pinholes import (
    Hits,
    Pinhole,
    Points,
    clamp_of_squared_distance,
    first_hits,
    overlapped_cells,
)
from rfpipe.scenes.radiosity import RadiosityScene, Rays
from rfpipe.scenes.surfaces import Obstruction, Occluder, Surface, is_occluded

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Albedo = Callable[[Double, NDArray[np.int64]], Double]

_PARTS = 4  # parts of a pixel along each axis
_MAX_BOX = 8  # maximum width of a box in pixels, to limit memory
_BOXES_AT_A_TIME = 2**16


def noncoaxial_scene(
    surfaces: Sequence[Surface],
    camera: Pinhole,
    projector: Pinhole,
    albedo: Albedo,
    *,
    occluders: Sequence[Occluder] = (),
    contrast: float = math.inf,
    **options: Any,
) -> RadiosityScene:
    """Build a scene with a camera and a separate projector.

    Rays without a hit carry no light.

    Parameters
    ----------
    surfaces, camera, projector, occluders
        The scene and the two pinholes; occluders also block the view of both pinholes.
    albedo
        Function of positions float64 (n, 3) and indices of surfaces int64 (n,) that returns the
        albedo in [0, 1), float64 (n, C).
    contrast
        Upper limit of a projector pixel's light per area, relative to that of a pixel of mean area
        at full strength; the light is dimmed accordingly.
    **options
        `bounces` and `name` of a `RadiosityScene`.

    Raises
    ------
    InputError
        If a pinhole is behind a plane or within a sphere, or an option is out of range.
    """
    from scipy.sparse import csr_array, eye_array

    view, lit = (
        _side(pinhole, opposite, tuple(surfaces), tuple(occluders), albedo)
        for pinhole, opposite in ((camera, projector), (projector, camera))
    )
    mean = float((view.hit_areas.mean() + lit.hit_areas.mean()) / 2)
    points_of_both = [np.concatenate(pair) for pair in zip(view[:4], lit[:4], strict=True)]
    surface, positions, areas, values = points_of_both
    points = Points(
        tuple(surfaces), surface, positions, areas, clamp_of_squared_distance(surfaces, mean)
    )
    scale = float(min(lit.hit_areas.mean(), contrast * lit.hit_areas.min()))
    direct = [
        csr_array(
            from_camera.multiply(1 / lit.areas) + from_projector.T.multiply(1 / view.areas[:, None])
        )
        * (scale / 2)
        for from_camera, from_projector in zip(view.common, lit.common, strict=True)
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
    """Surface points of the n pixels of one pinhole.

    Attributes
    ----------
    surface : ndarray of int64, shape (n,)
        Index of the surface, -1 without a hit.
    positions : ndarray, shape (n, 3)
    bounce_areas : ndarray, shape (n,)
        The areas a_i for indirect light.
    albedo : ndarray, shape (n, C)
        0 without a hit and for occluders.
    areas : ndarray, shape (n,)
        Covered areas; 1 without a hit.
    common : list of csr_array
        Sums over x in the first equation of the module, (n, pixels of the opposite pinhole), for
        each channel.
    """

    surface: NDArray[np.int64]
    positions: Double
    bounce_areas: Double
    albedo: Double
    areas: Double
    common: list[csr_array[np.float64]]

    @property
    def hit_areas(self) -> Double:
        """Areas of the pixels with a hit; 1 if there are none."""
        areas = self.areas[self.surface >= 0]
        return areas if len(areas) else np.ones(1)


def _side(
    pinhole: Pinhole,
    opposite: Pinhole,
    surfaces: tuple[Surface, ...],
    occluders: tuple[Occluder, ...],
    albedo: Albedo,
) -> _Side:
    """Compute the surface points of a pinhole, and their overlap with the opposite pinhole."""
    from scipy.sparse import csr_array, diags_array

    _require_inside(pinhole.origin, surfaces)
    hits, parts = first_hits(pinhole, surfaces), first_hits(pinhole, surfaces, _PARTS)
    obstructions = tuple(surface for surface in surfaces if isinstance(surface, Obstruction))
    visible = _is_visible(pinhole.origin, hits, occluders)
    visible_from_both = _is_visible(pinhole.origin, parts, occluders)
    visible_from_both &= _is_visible(opposite.origin, parts, (*obstructions, *occluders))
    weights = _weights(parts, opposite, visible_from_both)
    count, n_parts = len(hits.surface), _PARTS**2
    starts = np.arange(count + 1) * n_parts
    mean = csr_array((np.full(count * n_parts, 1 / n_parts), np.arange(count * n_parts), starts))
    reflectance = albedo(parts.positions, parts.surface)
    areas = np.where(hits.surface >= 0, hits.areas, 1)
    visible_fraction = np.asarray((mean @ weights).sum(axis=1))
    return _Side(
        hits.surface,
        hits.positions,
        areas * (1 - visible_fraction / 2),
        albedo(hits.positions, hits.surface) * visible[:, None],
        areas,
        [(mean @ diags_array(r) @ weights).tocsr() for r in reflectance.T],
    )


def _require_inside(origin: Double, surfaces: Sequence[Surface]) -> None:
    """Raise InputError if a pinhole is behind a plane, or within a block or a sphere."""
    for name in dict.fromkeys(surface.name for surface in surfaces):
        # outside a block means in front of at least one face
        faces = (surface for surface in surfaces if surface.name == name)
        if not any(face.heights(origin) > 0 for face in faces):
            raise InputError(
                f"projector at ({', '.join(f'{x:g}' for x in origin)}): is behind the surface "
                f"{name}; give it a position in the room, on the camera's side"
            )


def _is_visible(
    origin: Double, hits: Hits, obstructions: Sequence[Obstruction]
) -> NDArray[np.bool_]:
    """Test which surface points face a position, without an obstruction between them."""
    towards = ((origin - hits.positions) * hits.normals).sum(1) > 0
    occluded = is_occluded(origin, hits.positions, obstructions)
    return np.asarray((hits.surface >= 0) & towards & ~occluded)


def _weights(hits: Hits, opposite: Pinhole, visible: NDArray[np.bool_]) -> csr_array[np.float64]:
    """Distribute n parts of one pinhole's pixels to the opposite pinhole's pixels: (n, pixels).

    Rows add up to 1, to less at the edge of the picture, and to 0 where the part isn't visible.
    """
    from scipy.sparse import csr_array

    index = np.flatnonzero(visible)
    centre = opposite.project(hits.positions[index])
    sides = opposite.project_steps(hits.positions[index], hits.steps_to_neighbours(index))
    width = np.sqrt((sides**2).sum(axis=1))
    ahead = np.isfinite(centre).all(axis=1)
    index, centre, width = index[ahead], centre[ahead], np.minimum(width[ahead], _MAX_BOX)
    rows, columns = opposite.shape
    entries = [(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))]
    for first in range(0, len(index), _BOXES_AT_A_TIME):
        batch = slice(first, first + _BOXES_AT_A_TIME)
        box, row, column, weight = overlapped_cells(centre[batch], width[batch])
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        pixel = row * columns + column
        entries.append((weight[inside], index[batch][box[inside]], pixel[inside]))
    weight, part, pixel = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    return csr_array((weight, (part, pixel)), shape=(len(visible), rows * columns))
