"""A planar array of coaxial projector-camera pairs, and what their pixels see [thesis 5.2].

Lengths are in scene units. The array lies in the plane z = 0, around the origin, its rows along y
(down) and its columns along x; each pair is a pinhole that looks at (0, 0, `DISTANCE`). A single
pair is the pinhole at the origin that looks along +z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.geometry import sight_of
from rfpipe.scenes.panels import TexelGrid
from rfpipe.scenes.pinhole import Pinhole

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
        return self.pinholes()[0].pitch

    def pinholes(self) -> list[Pinhole]:
        """The views, in order."""
        x, y = (
            DISTANCE * np.tan(np.radians(span) / 2) * _spread(count)
            for span, count in zip(self.span_degrees, (self.grid or (1, 1))[::-1], strict=True)
        )
        middle = (0.0, 0.0, DISTANCE)
        return [
            _View(self.shape, (float(right), float(down), 0.0), middle) for down in y for right in x
        ]


class _View(Pinhole):
    """One view of an array."""

    @property
    def pitch(self) -> float:
        """Side of a pixel at distance 1."""
        return 2 * HALF_WIDTH / self.shape[1]


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
    for view, pinhole in enumerate(views.pinholes()):
        sight = sight_of(pinhole, grid.panels, samples)
        is_front = sight.areas > 0
        if not is_front.all():
            row, column = np.divmod(int(np.argmin(is_front)) // parts, views.shape[1])
            raise InputError(
                f"pixel ({row}, {column}) of view {view} sees nothing, or the back of a panel; "
                "give the views a smaller span"
            )
        moves = sight.moves(np.arange(len(is_front)))
        place, width = np.empty((2, len(is_front), 2))
        for index, panel in enumerate(grid.panels):
            on = sight.surface == index
            place[on] = panel.occluder.coordinates(sight.positions[on])[:, 1:]
            sides = panel.occluder.coordinates(np.asarray(panel.centre) + moves[on])
            width[on] = np.sqrt((sides[..., 1:] ** 2).sum(axis=1))
        texel, share = grid.overlaps(sight.surface, place, width)
        starts = np.arange(0, texel.size + 1, texel.size // pixels)
        matrix = csr_array(
            (share.ravel() / parts, texel.ravel(), starts), shape=(pixels, int(grid.starts[-1]))
        )
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        matrices.append(matrix)
        footprint.append(sight.areas.reshape(pixels, parts).sum(axis=1))
    return Sightings(vstack(matrices, format="csr", dtype=np.float64), np.concatenate(footprint))
