"""A room in front of an array of coaxial views: an 8D reflectance field [thesis 5.2, Fig. 5.8].

Surfaces are rectangles with a regular grid of texels. Each ray sees and lights a few texels, by the
weights in the rows of a sparse matrix P, which add up to 1: ``T = s P M P^T``, where M is the
matrix of `rfpipe.scenes.radiosity` over the texels.

Lengths are in scene units, angles in degrees. The array is in the plane z = 0, centred at the
origin, with rows along y (down) and columns along x; each view is a pinhole that looks at
(0, 0, `DISTANCE`). A single view is at the origin and looks along +z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.errors import InputError
from rfpipe.scenes.geometries import surface_albedo
from rfpipe.scenes.pinholes import Pinhole, Points, first_hits, overlapped_cells
from rfpipe.scenes.radiosity import RadiosityScene, Rays
from rfpipe.scenes.surfaces import Rectangle, Vector, block, horizontal, rotation, upright, vector

if TYPE_CHECKING:
    from scipy.sparse import csr_array


DISTANCE = 3.0
"""Distance from the array's plane to the point at which all views look."""

ROOM_SURFACES = ("left wall", "right wall", "floor")
"""Surfaces of the room that may be white or textured; the objects in it are textured."""

_WIDTH = 0.76  # width of a view's image plane at distance 1; 42 degrees
_PARTS = 3  # parts of a pixel along each axis, with a ray for each part
_PATCH = 2  # texels along each axis of a patch, the unit of indirect light
_TINTS: dict[str, Vector] = {
    "left wall": (1.05, 0.72, 0.55),
    "right wall": (0.62, 0.85, 1.05),
    "floor": (1.0, 0.98, 0.94),
    "box": (0.70, 1.0, 0.55),
    "poster": (1.06, 1.0, 0.60),
    "card": (1.06, 0.78, 0.92),
}


@dataclass(frozen=True)
class TexturedRectangle(Rectangle):
    """A rectangle with texels; `surface` and `tint` as in `surface_albedo`.

    Panels that `enclose` bound the room: the scene has no surfaces behind them.
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
    """Build the corner of a room with objects, seen by an array of views [Fig. 5.8].

    Parameters
    ----------
    surfaces
        ``"white"`` or ``"texture"`` for each of `ROOM_SURFACES`.
    shape, views
        Height and width of a view in pixels, and rows and columns of the array; 130 x 200 and
        3 x 3 in the thesis. Without `views`, there is one view and a ray domain (H, W).
    span_degrees
        Angles between the outermost columns, and rows, of the array, seen from the scene.
    channels, bounces, seed
        As for `planes_scene`.

    Raises
    ------
    InputError
        If a ray has no hit, or settings are out of range.
    """
    pinholes = view_array(views or (1, 1), span_degrees, shape)
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
    panels: Sequence[TexturedRectangle],
    domain: tuple[int, ...],
    *,
    channels: int,
    bounces: int,
    seed: int,
    name: str,
) -> RadiosityScene:
    """Build a scene of panels; panels that don't enclose it are obstructions.

    A texel is about as large as a pixel at `DISTANCE`. Only texels that are seen by a ray are
    included: light on all other texels is lost. `domain` is the shape of all pinholes' rays.
    """
    grid = TexelGrid(panels, DISTANCE * pinholes[0].pitch)
    visibility, footprint = texel_weights(pinholes, grid)
    texels = np.unique(visibility.indices).astype(np.int64)
    albedo = [
        surface_albedo(panel.surface, shape, channels, seed, index, panel.tint)
        for index, (panel, shape) in enumerate(zip(panels, grid.shapes.tolist(), strict=True))
    ]
    return RadiosityScene(
        grid.points(texels),
        np.concatenate([texel_albedo.reshape(-1, channels) for texel_albedo in albedo])[texels],
        bounces=bounces,
        scale=float(footprint.mean()) / len(pinholes),
        rays=Rays(domain, domain, visibility[:, texels]),
        patches=grid.patches(texels, _PATCH),
        name=name,
        pinholes=pinholes,
        about={
            "views": [asdict(pinhole) for pinhole in pinholes],
            "panels": [asdict(panel) for panel in panels],
            "parts": _PARTS,
            "patch": _PATCH,
        },
    )


def view_array(
    grid: tuple[int, int], span_degrees: tuple[float, float], shape: tuple[int, int]
) -> list[Pinhole]:
    """List the views of an array, row by row, as in `room_scene`."""
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
    """The texels of panels, numbered panel by panel and row by row.

    Panels are divided evenly into texels, whose sides are about `pitch` in scene units.
    """

    def __init__(self, panels: Sequence[TexturedRectangle], pitch: float) -> None:
        self.panels = tuple(panels)
        sides = 2 * np.linalg.norm([(panel.edge_v, panel.edge_u) for panel in panels], axis=2)
        self.shapes: NDArray[np.int64] = np.maximum(1, np.rint(sides / pitch)).astype(np.int64)
        counts = self.shapes.prod(axis=1)
        self.starts: NDArray[np.int64] = np.concatenate([[0], np.cumsum(counts)])
        self._areas = sides.prod(axis=1) / counts

    def points(self, texels: NDArray[np.int64]) -> Points:
        """Centres of texels, given by ascending number."""
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
        """Group texels, given by ascending number, into squares of `side` x `side`.

        Returns the squares as points, and the index of each texel's square.
        """
        points = self.points(texels)
        columns = self.shapes[points.surface, 1]
        row, column = np.divmod(texels - self.starts[points.surface], columns)
        # the number of the corner texel identifies the square
        corner = texels - row % side * columns - column % side
        _, first, patch = np.unique(corner, return_index=True, return_inverse=True)
        count = np.bincount(patch)
        centres = np.stack([np.bincount(patch, x) / count for x in points.positions.T], axis=1)
        areas = np.bincount(patch, points.areas).astype(np.float64)
        surface = points.surface[first]
        clamp = float(areas.mean())
        return Points(points.surfaces, surface, centres, areas, clamp), patch


def texel_weights(
    pinholes: Sequence[Pinhole], grid: TexelGrid
) -> tuple[csr_array[np.float64], Double]:
    """Compute the weights of the texels that each pixel of each view sees.

    A pixel is divided into parts. Each is represented by a box on the panel that its central ray
    hits, as wide as the part's outline but at most a texel, and distributed to the texels that it
    overlaps. Points instead of boxes would cause aliasing where texels and parts are equally dense.

    Returns
    -------
    texels, footprint
        Sparse (N, texels): weights of texels in each pixel, whose rows add up to 1; and float64
        (N,): the area that the pixel covers, scene units squared.

    Raises
    ------
    InputError
        If a ray hits no panel, or the back of one.
    """
    from scipy.sparse import csr_array, vstack

    pixels, parts = math.prod(pinholes[0].shape), _PARTS**2
    matrices, footprint = [], []
    for view, pinhole in enumerate(pinholes):
        hits = first_hits(pinhole, grid.panels, _PARTS)
        is_front = hits.areas > 0
        if not is_front.all():
            row, column = np.divmod(int(np.argmin(is_front)) // parts, pinhole.shape[1])
            raise InputError(
                f"pixel ({row}, {column}) of view {view} sees no panel, or the back of one; set a "
                "smaller span_degrees"
            )
        steps = hits.steps_to_neighbours()
        centre, width = np.empty((2, len(is_front), 2))
        for index, panel in enumerate(grid.panels):
            on_panel = hits.surface == index
            centre[on_panel] = panel.coordinates(hits.positions[on_panel])[:, 1:]
            sides = panel.coordinates(np.asarray(panel.centre) + steps[on_panel])
            width[on_panel] = np.sqrt((sides[..., 1:] ** 2).sum(axis=1))
        # from coordinates in [-1, 1] along both edges to rows and columns of texels
        counts = grid.shapes[hits.surface]
        centre, width = (centre[:, ::-1] + 1) / 2 * counts, width[:, ::-1] * counts / 2
        box, *position, weight = overlapped_cells(centre, np.minimum(width, 1))
        row, column = np.clip(np.stack(position), 0, counts[box].T - 1)  # clamp to the edge
        texel = grid.starts[hits.surface[box]] + row * counts[box, 1] + column
        shape = pixels, int(grid.starts[-1])
        matrices.append(csr_array((weight / parts, (box // parts, texel)), shape=shape))
        footprint.append(hits.areas.reshape(pixels, parts).sum(axis=1))
    return vstack(matrices, format="csr", dtype=np.float64), np.concatenate(footprint)


def room_panels(surfaces: Sequence[str]) -> tuple[TexturedRectangle, ...]:
    """Build the panels of the room, in the coordinates of the array of views.

    Two walls at a right angle and a floor, and in front of them a box, a poster and a floating
    card. These occlude parts of the walls from some views, cast shadows that depend on the view,
    and exchange light.
    """
    # The room's coordinates have x to the right, y down, z away, and the origin at the point at
    # which the views look. Walls and floor are 2 x `wall` long, more than the views see.
    floor, corner, wall = 0.42, 0.75, 3.0
    middle = floor + 0.1 - wall  # walls extend below the floor, to avoid a gap
    walls = (
        upright("left wall", (0, middle, corner), (wall, wall), 45),
        upright("right wall", (0, middle, corner), (wall, wall), -45),
        horizontal("floor", (0, floor, corner - wall + 0.1), (wall, wall), 0),
    )
    objects = (
        *block("box", (-0.28, floor, 0.02), side=0.42, height=0.5, turned=32),
        upright("poster", (0.42, floor - 0.3, -0.12), (0.26, 0.3), -20),
        horizontal("card", (-0.38, -0.42, -0.1), (0.22, 0.15), 15),
    )
    return (
        *(_panel(wall, kind, encloses=True) for wall, kind in zip(walls, surfaces, strict=True)),
        *(_panel(rectangle, "texture") for rectangle in objects),
    )


def _panel(rectangle: Rectangle, surface: str, *, encloses: bool = False) -> TexturedRectangle:
    """Transform a rectangle to the views' coordinates; views look down by 35 degrees."""
    name, tilt = rectangle.name, rotation(0, 35)
    centre, *edges = (
        tilt @ value for value in (rectangle.centre, rectangle.edge_u, rectangle.edge_v)
    )
    origin = vector(np.add(centre, (0, 0, DISTANCE)))
    return TexturedRectangle(
        origin, vector(edges[0]), vector(edges[1]), name, surface, _TINTS[name], encloses
    )
