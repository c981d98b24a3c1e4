"""A planar array of coaxial projector-camera pairs, and what their pixels see [thesis 5.2].

Lengths are in scene units. The array lies in the plane z = 0, around the origin, its rows along y
(down) and its columns along x; each pair is a pinhole that looks at (0, 0, `DISTANCE`). A single
pair is the pinhole at the origin that looks along +z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.panels import Panel, TexelGrid

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["DISTANCE", "HALF_WIDTH", "Sightings", "ViewArray", "sightings"]

DISTANCE = 3.0
"""From the array's plane to the point at which every view looks."""

HALF_WIDTH = 0.38
"""Of a view's image plane at distance 1: views are 42 degrees wide."""


@dataclass(frozen=True)
class ViewArray:
    """Views in rows and columns.

    Parameters
    ----------
    grid
        Rows and columns of views, each at least 1; None for one view by itself.
    span_degrees
        Angles under which the outermost columns and rows appear from the point that the views
        look at, horizontally and vertically.
    shape
        Height and width of a view in pixels.
    """

    grid: tuple[int, int] | None
    span_degrees: tuple[float, float]
    shape: tuple[int, int]

    @property
    def count(self) -> int:
        """Number of views; they are numbered row by row."""
        rows, columns = self.grid or (1, 1)
        return rows * columns

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the ray domain: (V, H, W), or (H, W) of one view by itself."""
        return self.shape if self.grid is None else (self.count, *self.shape)

    @property
    def pitch(self) -> float:
        """Side of a pixel at distance 1."""
        return 2 * HALF_WIDTH / self.shape[1]

    def positions(self) -> NDArray[np.float64]:
        """Where the views are: float64 (views, 3)."""
        x, y = (
            DISTANCE * np.tan(np.radians(span) / 2) * _spread(count)
            for span, count in zip(self.span_degrees, (self.grid or (1, 1))[::-1], strict=True)
        )
        down, right = np.meshgrid(y, x, indexing="ij")
        return np.stack([right.ravel(), down.ravel(), np.zeros(self.count)], axis=1)

    def axes(self, view: int) -> NDArray[np.float64]:
        """Unit vectors to a view's right, down and ahead: float64 (3, 3)."""
        ahead = np.array([0, 0, DISTANCE]) - self.positions()[view]
        ahead /= np.linalg.norm(ahead)
        right = np.cross([0, 1, 0], ahead)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(ahead, right), ahead])

    def parts(self, samples: int) -> NDArray[np.float64]:
        """Where the parts of the pixels, `samples` x `samples` each, are on the image plane.

        float64 (2, H W samples^2): to the right and down at distance 1, pixel by pixel.
        """
        within = (np.arange(samples) + 0.5) / samples
        y, x = (
            ((np.arange(length)[:, None] + within) - length / 2) * self.pitch
            for length in self.shape
        )
        across = x[None, :, None, :], y[:, None, :, None]
        return np.stack([part.ravel() for part in np.broadcast_arrays(*across)])


def _spread(count: int) -> NDArray[np.float64]:
    """Numbers from -1 to 1, or 0 alone."""
    return np.linspace(-1, 1, count) if count > 1 else np.zeros(1)


@dataclass(frozen=True)
class Sightings:
    """What the pixels of an array see.

    Parameters
    ----------
    texels
        Sparse (N, texels): how much of each texel a pixel sees; rows add up to 1.
    footprint
        float64 (N,): area of the surfaces that a pixel covers, scene units squared.
    """

    texels: csr_array[np.float64]
    footprint: NDArray[np.float64]


def sightings(views: ViewArray, grid: TexelGrid, samples: int) -> Sightings:
    """Find the texels that each pixel of each view sees.

    A pixel is cut into `samples` x `samples` parts, which stand for boxes on the panel that their
    central rays meet: boxes as wide as the parts' outlines, shared out between the texels that
    they overlap. Points instead of boxes would make ripples where texels and parts are about as
    dense.

    Parameters
    ----------
    views
        The array.
    grid
        The scene's panels and their texels.
    samples
        Parts of a pixel along either side.

    Returns
    -------
    Sightings
        Of all views, in order.

    Raises
    ------
    InputError
        If a ray meets no panel, or the back of one.
    """
    from scipy.sparse import csr_array, vstack

    pixels, parts = views.shape[0] * views.shape[1], samples**2
    matrices, footprint = [], []
    image = views.parts(samples)
    for view, position in enumerate(views.positions()):
        met = _meet(position, views.axes(view), image, views.pitch / samples, grid.panels)
        if not met.is_front.all():
            row, column = np.divmod(int(np.argmin(met.is_front)) // parts, views.shape[1])
            raise InputError(
                f"pixel ({row}, {column}) of view {view} sees nothing, or the back of a panel; "
                "give the views a smaller span"
            )
        texel, share = grid.overlaps(met.panel, met.place, met.width)
        starts = np.arange(0, texel.size + 1, texel.size // pixels)
        matrix = csr_array(
            (share.ravel() / parts, texel.ravel(), starts), shape=(pixels, int(grid.starts[-1]))
        )
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        matrices.append(matrix)
        areas = views.pitch**2 * met.depth**2 / met.slope
        footprint.append(areas.reshape(pixels, parts).mean(axis=1))
    return Sightings(vstack(matrices, format="csr", dtype=np.float64), np.concatenate(footprint))


@dataclass(frozen=True)
class _Meeting:
    """Where n rays first meet a panel.

    `panel` (n,) and `place` (n, 2), from -1 to 1 along its edges; `width` (n, 2) of the part's
    outline there; `depth` (n,) along the view's axis; `slope` (n,), the ray's component along the
    panel's normal; `is_front` (n,), whether they meet its front.
    """

    panel: NDArray[np.int64]
    place: NDArray[np.float64]
    width: NDArray[np.float64]
    depth: NDArray[np.float64]
    slope: NDArray[np.float64]
    is_front: NDArray[np.bool_]


def _meet(
    origin: NDArray[np.float64],
    axes: NDArray[np.float64],
    image: NDArray[np.float64],
    step: float,
    panels: Sequence[Panel],
) -> _Meeting:
    """Follow the rays through places (2, n) of an image plane to the nearest panels.

    `axes` (3, 3) are the image plane's right and down and the way to it; `step` is the distance
    between neighbouring places.
    """
    n = image.shape[1]
    found = _Meeting(
        np.zeros(n, dtype=np.int64),
        np.zeros((n, 2)),
        np.zeros((n, 2)),
        np.full(n, np.inf),
        np.ones(n),
        np.zeros(n, dtype=np.bool_),
    )
    for index, panel in enumerate(panels):
        here = panel.occluder.coordinates(origin)
        right, down, ahead = panel.occluder.coordinates(np.asarray(panel.centre) + axes)
        sunk, *along = (
            a + image[0] * r + image[1] * d for r, d, a in zip(right, down, ahead, strict=True)
        )
        with np.errstate(divide="ignore", invalid="ignore"):  # rays within the panel's plane
            depth = -here[0] / sunk
            u, v = (start + depth * part for start, part in zip(here[1:], along, strict=True))
            hit = np.flatnonzero(
                (depth > 0) & (depth < found.depth) & (np.abs(u) <= 1) & (np.abs(v) <= 1)
            )
        depth, sunk = depth[hit], sunk[hit]
        found.panel[hit] = index
        found.depth[hit] = depth
        found.slope[hit] = np.abs(sunk)
        found.is_front[hit] = panel.plane.heights(origin) > 0
        for edge, (place, part) in enumerate(zip((u, v), along, strict=True)):
            found.place[hit, edge] = place[hit]
            # how far the place moves from one part of a pixel to the next, in either direction;
            # together the standard deviation of the part's outline
            moves = [
                depth * step * (side[1 + edge] - side[0] / sunk * part[hit])
                for side in (right, down)
            ]
            found.width[hit, edge] = np.hypot(*moves)
    return found
