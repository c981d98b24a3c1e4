"""Charts: one image on which every camera ray has a place.

Indirect light is smooth over the surfaces of the scene. The functions that describe it are defined
on a chart, an image in which neighbouring pixels are neighbouring points of surfaces. With one
projector view the camera's image is the chart. In a light field every view has an image of the same
surfaces; then the image of the middle projector view is the chart for all of them. A ray's place on
it is the centre of its footprint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Bools, Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.images import nearest_known
from rfpipe.transport.multiscale import MultiscaleBasis, function_grid, spline_values

if TYPE_CHECKING:
    from scipy.sparse import csr_array


# A place is known where direct light exceeds both shares: of the floodlit image, and of the median
# direct light.
_LEAST_SHARE_OF_FLOODLIT, _LEAST_SHARE_OF_MEDIAN = 0.3, 0.2


@dataclass(frozen=True)
class Chart:
    """Image on which every camera ray has a place.

    Attributes
    ----------
    shape : tuple of int
    places : ndarray of float64, shape (M, 2), optional
        Row and column in pixels; the first pixel's centre is at 1/2. None if the chart is the
        camera's ray domain itself.
    """

    shape: tuple[int, ...]
    places: Double | None = None

    def basis(self, functions: NDArray[np.int32]) -> MultiscaleBasis:
        """Return the basis of functions, int32 (n, 4), with values at the camera rays."""
        if self.places is None:
            return MultiscaleBasis(self.shape, functions)
        return ChartBasis(self.shape, functions, self.places)

    def chart_cells(self, scale: int) -> Index:
        """Return the number of the chart cell in which each camera ray lies, (M,).

        Chart cells are squares of the chart with a side of `scale` pixels, which is also the
        spacing of the functions of that scale.
        """
        (_, down, across), cell = RayDomain(self.shape).square_cells(scale)
        if self.places is None:
            return cell
        row, column = (self.places.T // scale).astype(np.int64)
        number: Index = np.clip(row, 0, down - 1) * across + np.clip(column, 0, across - 1)
        return number


class ChartBasis(MultiscaleBasis):
    """B-splines on a chart; `weights` has their values at camera rays.

    Parameters
    ----------
    shape, functions
        See `MultiscaleBasis`.
    places : ndarray of float64, shape (M, 2)
        See `Chart`.
    """

    def __init__(
        self, shape: tuple[int, ...], functions: NDArray[np.int32], places: Double
    ) -> None:
        super().__init__(shape, functions)
        self.places = places

    @cached_property
    def weights(self) -> csr_array[np.float32]:
        """Values of the functions at the camera rays, sparse float32 (M, n)."""
        return self.at(self.places)

    def at(self, places: Double) -> csr_array[np.float32]:
        """Compute the values of the functions at places (rays, 2), sparse float32 (rays, n)."""
        from scipy.sparse import csr_array

        rows, columns, values = [], [], []
        last = np.asarray(self.shape[-2:]) - 1e-6
        for scale in np.unique(self.scales):
            (down, y), (across, x) = (
                spline_values(axis, int(scale)) for axis in np.clip(places, 0, last).T
            )
            table = function_grid(self.functions, self.shape, int(scale))[0]
            number = table[down[:, :, None], across[:, None, :]]
            value = y[:, :, None] * x[:, None, :]
            exists = number >= 0
            rows.append(np.nonzero(exists)[0])
            columns.append(number[exists])
            values.append(value[exists])
        index = (np.concatenate(rows), np.concatenate(columns))
        shape = (len(places), len(self))
        return csr_array((np.concatenate(values), index), shape=shape).astype(np.float32)


def chart_from_view(
    camera: RayDomain, direct: csr_array[np.float32], shape: tuple[int, int], floodlit: Float
) -> Chart:
    """Make a chart of the image of a projector view.

    Parameters
    ----------
    camera : RayDomain
    direct : csr_array of float32, shape (M, N)
        D of the view.
    shape : tuple of int
        Height and width of its image.
    floodlit : ndarray of float32, shape (M,)
        Floodlit image of the view, radiance.

    Returns
    -------
    Chart
        With a margin around the image for rays that see no part of it, at most half of its short
        side.
    """
    height, width = shape
    pixel = np.arange(height * width)
    centres = np.stack([pixel // width + 0.5, pixel % width + 0.5], axis=1)
    light = np.asarray(direct.sum(axis=1), np.float64).ravel()
    places = (direct @ centres) / np.maximum(light, TINY)[:, None]
    median = float(np.median(light[light > 0])) if (light > 0).any() else 0.0
    known = light > _LEAST_SHARE_OF_FLOODLIT * floodlit
    known &= light > _LEAST_SHARE_OF_MEDIAN * median
    places = _extrapolated(camera, places, known, np.array(shape))
    excess = max(-places.min(), (places - shape).max(), 0.0)
    margin = int(min(np.ceil(excess), np.floor(0.5 * min(shape))))
    return Chart((height + 2 * margin, width + 2 * margin), places + margin)


def _extrapolated(camera: RayDomain, places: Double, known: Bools, shape: Index) -> Double:
    """Give rays of unknown place the parallax of the nearest ray that has one, view by view."""
    views, height, width = camera.stack_shape
    # places if there were no parallax
    row, column = np.indices((height, width)).reshape(2, -1) + 0.5
    expected = np.stack([row * shape[0] / height, column * shape[1] / width], axis=-1)
    parallax = places.reshape(views, -1, 2) - expected
    for in_view, known_in_view in zip(parallax, known.reshape(views, height, width), strict=True):
        in_view[:] = in_view[nearest_known(known_in_view)] if known_in_view.any() else 0
    extrapolated: Double = (expected + parallax).reshape(-1, 2)
    return extrapolated
