"""The room that an array of coaxial views looks at: an 8D reflectance field [thesis 5.2, Fig. 5.8].

Its surfaces are rectangles with a regular grid of texels. Each ray sees, and lights, a few texels:
a sparse matrix P, whose rows add up to 1, says which and in what proportion, and
``T = s P M P^T`` with M the matrix of `rfpipe.scenes.radiosity` over the texels.

Lengths are in scene units, angles in degrees. The array lies in the plane z = 0, around the origin,
its rows along y (down) and its columns along x; each pair is a pinhole that looks at
(0, 0, `DISTANCE`). A single pair is the pinhole at the origin that looks along +z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.geometries import surface_albedo
from rfpipe.scenes.radiosity import RadiosityScene, Rays
from rfpipe.scenes.sight import Pinhole, Points, overlaps, sight_of
from rfpipe.scenes.surfaces import Rectangle, Vector, block, lying, rotation, standing, vector

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Double = NDArray[np.float64]

DISTANCE = 3.0
"""From the array's plane to the point at which every view looks."""

ROOM_SURFACES = ("left wall", "right wall", "floor")
"""The surfaces of the room that may be white or textured; all others are textured."""

_WIDTH = 0.76  # of a view's image plane at distance 1: views are 42 degrees wide
_PARTS = 3  # of a pixel along either side, each seen along a ray of its own
_PATCH = 2  # texels along either side of a patch that indirect light takes for one
_TINTS: dict[str, Vector] = {
    "left wall": (1.05, 0.72, 0.55),
    "right wall": (0.62, 0.85, 1.05),
    "floor": (1.0, 0.98, 0.94),
    "box": (0.70, 1.0, 0.55),
    "poster": (1.06, 1.0, 0.60),
    "card": (1.06, 0.78, 0.92),
}


@dataclass(frozen=True)
class Panel(Rectangle):
    """A rectangle with texels, white or textured, and tinted as of `surface_albedo`.

    One that `encloses` bounds the room, so that nothing of the scene is behind it.
    """

    surface: str
    tint: Vector
    encloses: bool = False


def room_scene(
    surfaces: Sequence[str],
    shape: tuple[int, int],
    *,
    views: tuple[int, int] | None = None,
    span_degrees: tuple[float, float] = (37.0, 29.0),
    channels: int = 3,
    bounces: int = 3,
    seed: int = 0,
) -> RadiosityScene:
    """Build the corner of a room with things in it, seen by an array of views [Fig. 5.8].

    Parameters
    ----------
    surfaces
        ``"white"`` or ``"texture"`` for each of `ROOM_SURFACES`.
    shape, views
        Height and width of a view in pixels, rows and columns of the array: 130 x 200 and 3 x 3 are
        the thesis'. One view, and a ray domain (H, W), where `views` is None.
    span_degrees
        Angles under which the outermost columns and rows of the array appear from the scene.
    channels, bounces, seed
        As for `planes_scene`.

    Raises
    ------
    InputError
        If a ray sees nothing, or settings are out of range.
    """
    pinholes = array_of(views or (1, 1), span_degrees, shape)
    domain = shape if views is None else (len(pinholes), *shape)
    name = f"room of {', '.join(surfaces)}"
    return panels_scene(
        pinholes,
        room_panels(surfaces),
        domain,
        channels=channels,
        bounces=bounces,
        seed=seed,
        name=name,
    )


def panels_scene(
    pinholes: Sequence[Pinhole],
    panels: Sequence[Panel],
    domain: tuple[int, ...],
    *,
    channels: int,
    bounces: int,
    seed: int,
    name: str,
) -> RadiosityScene:
    """Build a scene of panels, those that don't enclose it hiding others from each other.

    A texel is about as large as a pixel where the views look. Only texels that some ray sees take
    part: light that falls elsewhere is lost. `domain` is the shape of all pinholes' rays.
    """
    grid = TexelGrid(panels, DISTANCE * pinholes[0].pitch)
    visibility, footprint = sightings(pinholes, grid)
    texels = np.unique(visibility.indices).astype(np.int64)
    albedo = [
        surface_albedo(panel.surface, shape, channels, seed, index, panel.tint)
        for index, (panel, shape) in enumerate(zip(panels, grid.shapes.tolist(), strict=True))
    ]
    return RadiosityScene(
        grid.points(texels),
        np.concatenate([each.reshape(-1, channels) for each in albedo])[texels],
        bounces=bounces,
        scale=float(footprint.mean()) / len(pinholes),
        rays=Rays(domain, domain, visibility[:, texels]),
        patches=grid.patches(texels, _PATCH),
        name=name,
        about={
            "views": [asdict(pinhole) for pinhole in pinholes],
            "panels": [asdict(panel) for panel in panels],
            "parts": _PARTS,
            "patch": _PATCH,
        },
    )


def array_of(
    grid: tuple[int, int], span_degrees: tuple[float, float], shape: tuple[int, int]
) -> list[Pinhole]:
    """Return the views of an array of rows and columns, row by row, as `room_scene` describes."""
    x, y = (
        DISTANCE * np.tan(np.radians(span) / 2) * (np.linspace(-1, 1, n) if n > 1 else np.zeros(1))
        for span, n in zip(span_degrees, grid[::-1], strict=True)
    )
    middle = (0.0, 0.0, DISTANCE)
    return [
        Pinhole(shape, (float(right), float(down), 0.0), middle, width=_WIDTH)
        for down in y
        for right in x
    ]


class TexelGrid:
    """The texels of some panels, numbered panel by panel and row by row.

    Their sides are about `pitch`, scene units: a panel has a whole number of them either way.
    """

    def __init__(self, panels: Sequence[Panel], pitch: float) -> None:
        self.panels = tuple(panels)
        sides = 2 * np.linalg.norm([(panel.edge_v, panel.edge_u) for panel in panels], axis=2)
        self.shapes: NDArray[np.int64] = np.maximum(1, np.rint(sides / pitch)).astype(np.int64)
        counts = self.shapes.prod(axis=1)
        self.starts: NDArray[np.int64] = np.concatenate([[0], np.cumsum(counts)])
        self._areas = sides.prod(axis=1) / counts

    def points(self, texels: NDArray[np.int64]) -> Points:
        """The centres of some texels, given by ascending number."""
        panel = np.searchsorted(self.starts, texels, "right") - 1
        row, column = np.divmod(texels - self.starts[panel], self.shapes[panel, 1])
        v, u = (2 * (np.stack([row, column]) + 0.5) / self.shapes[panel].T - 1)[..., None]
        centre, edge_u, edge_v = (
            np.array([getattr(panel, name) for panel in self.panels])[panel]
            for name in ("centre", "edge_u", "edge_v")
        )
        areas = self._areas[panel]
        return Points(
            tuple(panel.plane if panel.encloses else panel for panel in self.panels),
            panel,
            centre + u * edge_u + v * edge_v,
            areas,
            float(areas.mean()),
        )

    def patches(self, texels: NDArray[np.int64], side: int) -> tuple[Points, NDArray[np.int64]]:
        """Take texels, given by ascending number, together in squares of `side` x `side`.

        Returns the squares as points, and the square that each texel belongs to.
        """
        points = self.points(texels)
        columns = self.shapes[points.surface, 1]
        row, column = np.divmod(texels - self.starts[points.surface], columns)
        # the number of the texel in its square's corner tells squares apart
        corner = texels - row % side * columns - column % side
        _, first, patch = np.unique(corner, return_index=True, return_inverse=True)
        count = np.bincount(patch)
        centres = np.stack([np.bincount(patch, x) / count for x in points.positions.T], axis=1)
        areas = np.bincount(patch, points.areas).astype(np.float64)
        surface = points.surface[first]
        clamp = float(areas.mean())
        return Points(points.surfaces, surface, centres, areas, clamp), patch


def sightings(pinholes: Sequence[Pinhole], grid: TexelGrid) -> tuple[csr_array[np.float64], Double]:
    """Find the texels that each pixel of each view sees.

    A pixel is cut into parts, which stand for boxes on the panel that their central rays meet:
    boxes as wide as the parts' outlines, at most a texel, shared out between the texels that they
    overlap. Points instead of boxes would make ripples where texels and parts are about as dense.

    Returns
    -------
    texels, footprint
        Sparse (N, texels): how much of each texel a pixel sees, rows add up to 1; and float64 (N,):
        the area that it covers, scene units squared.

    Raises
    ------
    InputError
        If a ray meets no panel, or the back of one.
    """
    from scipy.sparse import csr_array, vstack

    pixels, parts = math.prod(pinholes[0].shape), _PARTS**2
    matrices, footprint = [], []
    for view, pinhole in enumerate(pinholes):
        sight = sight_of(pinhole, grid.panels, _PARTS)
        is_front = sight.areas > 0
        if not is_front.all():
            row, column = np.divmod(int(np.argmin(is_front)) // parts, pinhole.shape[1])
            raise InputError(
                f"pixel ({row}, {column}) of view {view} sees nothing, or the back of a panel; "
                "give the views a smaller span"
            )
        moves = sight.moves()
        place, width = np.empty((2, len(is_front), 2))
        for index, panel in enumerate(grid.panels):
            on = sight.surface == index
            place[on] = panel.coordinates(sight.positions[on])[:, 1:]
            sides = panel.coordinates(np.asarray(panel.centre) + moves[on])
            width[on] = np.sqrt((sides[..., 1:] ** 2).sum(axis=1))
        # rows and columns of texels, where a panel goes from -1 to 1 along either edge
        counts = grid.shapes[sight.surface]
        place, width = (place[:, ::-1] + 1) / 2 * counts, width[:, ::-1] * counts / 2
        box, *at, share = overlaps(place, np.minimum(width, 1))
        row, column = np.clip(np.stack(at), 0, counts[box].T - 1)  # what is beyond, at the edge
        texel = grid.starts[sight.surface[box]] + row * counts[box, 1] + column
        shape = pixels, int(grid.starts[-1])
        matrices.append(csr_array((share / parts, (box // parts, texel)), shape=shape))
        footprint.append(sight.areas.reshape(pixels, parts).sum(axis=1))
    return vstack(matrices, format="csr", dtype=np.float64), np.concatenate(footprint)


def room_panels(surfaces: Sequence[str]) -> tuple[Panel, ...]:
    """Furnish the room, in scene units as the array of views sees it.

    Two walls that meet at a right angle and a floor; in front of them a box, a poster and a card in
    the air. They hide parts of the walls from some views, throw shadows that move with the light,
    and reflect light onto each other.
    """
    # The room stands in a frame of its own: x to the right, y down, z away, and its origin where
    # the views look, down at it. Walls and floor have twice `wall` as sides: more than views see.
    floor, corner, wall = 0.42, 0.75, 3.0
    middle = floor + 0.1 - wall  # a little of the walls goes below the floor: no gap
    walls = (
        standing("left wall", (0, middle, corner), (wall, wall), 45),
        standing("right wall", (0, middle, corner), (wall, wall), -45),
        lying("floor", (0, floor, corner - wall + 0.1), (wall, wall), 0),
    )
    things = (
        *block("box", (-0.28, floor, 0.02), side=0.42, height=0.5, turned=32),
        standing("poster", (0.42, floor - 0.3, -0.12), (0.26, 0.3), -20),
        lying("card", (-0.38, -0.42, -0.1), (0.22, 0.15), 15),
    )
    return (
        *(_seen(wall, kind, encloses=True) for wall, kind in zip(walls, surfaces, strict=True)),
        *(_seen(thing, "texture") for thing in things),
    )


def _seen(rectangle: Rectangle, surface: str, *, encloses: bool = False) -> Panel:
    """Return a panel as the views see it, looking down."""
    name, tilt = rectangle.name, rotation(0, 35)
    centre, *edges = (
        tilt @ each for each in (rectangle.centre, rectangle.edge_u, rectangle.edge_v)
    )
    placed = vector(np.add(centre, (0, 0, DISTANCE))), vector(edges[0]), vector(edges[1])
    return Panel(*placed, name, surface, _TINTS[name], encloses)
