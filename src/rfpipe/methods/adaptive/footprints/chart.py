"""Where the rays of several views meet: one chart of the surfaces, and smooth functions on it.

Views of a light field see the same surfaces. Their footprints on one view, the middle one, tell
where on its image each ray of all views falls; functions on that image, its edges carried on, then
serve all views at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.series import Double, Float, Int64
from rfpipe.transport.multiscale import (
    Functions,
    MultiscaleBasis,
    along,
    cells,
    numbers,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Chart:
    """An image of which every camera ray sees a place.

    Attributes
    ----------
    shape : tuple of int
        ``(h, w)``, or the camera's own where each ray is its own place.
    places : ndarray of float64, shape (rays, 2), optional
        Row and column in pixels; None where each ray is its own place.
    """

    shape: tuple[int, ...]
    places: Double | None = None

    def basis(self, functions: Functions) -> MultiscaleBasis:
        """Return functions on the chart, over the camera's rays."""
        if self.places is None:
            return MultiscaleBasis(self.shape, functions)
        return ChartBasis(self.shape, functions, self.places)

    def cell_of(self, scale: int) -> Int64:
        """Return the number of the cell of a scale in which each camera ray lies, (rays,)."""
        _, down, across = cells(self.shape, scale)
        if self.places is None:
            view, row, column = np.indices(RayDomain(self.shape).stack_shape).reshape(3, -1)
            found: Int64 = (view * down + row // scale) * across + column // scale
            return found
        row, column = (self.places.T // scale).astype(np.int64)
        inside: Int64 = np.clip(row, 0, down - 1) * across + np.clip(column, 0, across - 1)
        return inside


class ChartBasis(MultiscaleBasis):
    """Functions on a chart.

    Parameters
    ----------
    shape, functions
        See `MultiscaleBasis`.
    places : ndarray of float64, shape (rays, 2)
        Row and column on the chart of each ray that `weights` are for.
    """

    def __init__(self, shape: tuple[int, ...], functions: Functions, places: Double) -> None:
        super().__init__(shape, functions)
        self.places = places

    @cached_property
    def weights(self) -> csr_array[np.float32]:
        """The functions' values at the rays' places, sparse float32 (rays, n)."""
        return self.at(self.places)

    def at(self, places: Double) -> csr_array[np.float32]:
        """Return the functions' values at places (rays, 2), sparse float32 (rays, n)."""
        from scipy.sparse import csr_array

        rays, owners, values = [], [], []
        last = np.asarray(self.shape[-2:]) - 1e-6
        for scale in np.unique(self.scales):
            (down, y), (across, x) = (
                along(axis, int(scale)) for axis in np.clip(places, 0, last).T
            )
            own = numbers(self.functions, self.shape, int(scale))[0]
            number = own[down[:, :, None], across[:, None, :]]
            value = y[:, :, None] * x[:, None, :]
            there = number >= 0
            rays.append(np.nonzero(there)[0])
            owners.append(number[there])
            values.append(value[there])
        where = (np.concatenate(rays), np.concatenate(owners))
        shape = (len(places), len(self))
        return csr_array((np.concatenate(values), where), shape=shape).astype(np.float32)


def chart_of(
    camera: RayDomain, middle: csr_array[np.float32], shape: tuple[int, int], floodlit: Float
) -> Chart:
    """Make a chart of a projector view's image (height, width).

    `middle` are the footprints on the view, (camera rays, rays of the view), `floodlit` the
    radiance when all of the view is lit. A ray's place is known where direct light is a part of the
    floodlit image, and of a typical ray's. The chart reaches beyond its view's image by half of its
    short side at most.
    """
    height, width = shape
    ray = np.arange(height * width)
    own = np.stack([ray // width + 0.5, ray % width + 0.5], axis=1)
    light = np.asarray(middle.sum(axis=1), np.float64).ravel()
    places = (middle @ own) / np.maximum(light, np.finfo(np.float32).tiny)[:, None]
    usual = float(np.median(light[light > 0])) if (light > 0).any() else 0.0
    known = (light > 0.3 * floodlit) & (light > 0.2 * usual)
    places = _carried_on(camera, places, known, np.array(shape))
    beyond = max(-places.min(), (places - shape).max(), 0.0)
    margin = int(min(np.ceil(beyond), np.floor(0.5 * min(shape))))
    return Chart((height + 2 * margin, width + 2 * margin), places + margin)


def _carried_on(
    camera: RayDomain, places: Double, known: NDArray[np.bool_], shape: NDArray[np.int64]
) -> Double:
    """Let rays of unknown place lie beside the nearest that is known, view by view."""
    from scipy.ndimage import distance_transform_edt

    views, height, width = camera.stack_shape
    # a camera's pixel as a place on the projector's image, were there no parallax
    row, column = np.indices((height, width)).astype(np.float64) + 0.5
    own = np.stack([row * shape[0] / height, column * shape[1] / width], axis=-1)
    aside = places.reshape(views, height, width, 2) - own
    found = np.empty_like(aside)
    for view, there in enumerate(known.reshape(views, height, width)):
        if not there.any():
            found[view] = own
            continue
        nearest = distance_transform_edt(~there, return_distances=False, return_indices=True)
        found[view] = own + aside[view][tuple(nearest)]
    carried: Double = found.reshape(-1, 2)
    return carried
