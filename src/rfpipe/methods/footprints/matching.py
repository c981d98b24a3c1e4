"""Whitened matched filter: the place of the projector whose patterns a camera pixel resembles most.

A camera pixel that sees a box of the projector's image has, relative to its floodlit radiance, the
series over P patterns

    y = (part of the light that is direct) t + indirect light + noise

where t is the light of the box. Nothing is known of the scene yet, so indirect light is taken as
normal, and correlated over pictures as the patterns are. The covariance of y without the box is

    Q Q^T = (0.1^2 + noise) I + 5^2 1 1^T + 0.5^2 E^T E / coarse_cells + 0.14^2 u u^T

for errors of the model and noise, light that is the same in all pictures, light from far away, and
light in proportion to the mean of a pattern. Both sides are whitened by ``Q^-1``, so that indirect
light makes no match:

    correlation = (Q^-1 y) . (Q^-1 t) / (|Q^-1 y| |Q^-1 t|)

===============  =========================  =================  =====================================
symbol           name in the code           shape              meaning
===============  =========================  =================  =====================================
``y``            `series`                   (m, P)             radiance of m camera pixels over
                                                               their floodlit radiance
``t``            `BoxTemplates.response`    (boxes, P)         mean of each pattern over each box,
                                                               0 to 1
``E``            `coarse_light`             (coarse_cells, P)  mean of each pattern over coarse
                                                               cells, minus 1/2
``u``            `mean_light`               (P,)               mean of each pattern, minus 1/2
``noise``        `relative_noise`           ()                 variance of a picture, over the
                                                               squared floodlit radiance
``Q``            `MatchedFilter.whitening`  (P, P)             Cholesky factor; the code has
                                                               ``Q^-T``, applied from the right
``correlation``  `Matches.correlation`      (m,)               correlation of the best box, -1 to 1
===============  =========================  =================  =====================================

Coarse cells are squares of the projector's image, 6 along its short side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import unique_keys
from rfpipe.methods.footprints.pictures import ViewPictures

# Largest number of pairs of a series and a box to compare: half a minute for 25 pictures.
_MOST_PAIRS = 2**31
# Products of series and boxes computed in one batch.
_BATCH_PRODUCTS = 2**24
# Pixels of the coarse grid that are compared with all boxes, in each camera view.
_GRID_PIXELS = 2048
# Cells of coarse light along the short side of the projector's image.
_COARSE_CELLS = 6


@dataclass(frozen=True)
class BoxTemplates:
    """Patterns on one projector view, averaged over boxes of two widths at half-pixel positions.

    Attributes
    ----------
    projector : RayDomain
        Of the view.
    response : ndarray of float32, shape (boxes, P)
        Mean of each pattern over each box, 0 to 1.
    centre : ndarray of float64, shape (boxes, 2)
        Row and column in pixels; the first pixel's centre is at 1/2.
    width : ndarray of float64, shape (boxes,)
        In pixels.
    """

    projector: RayDomain
    response: Float
    centre: Double
    width: Double

    @property
    def most_series(self) -> int:
        """Largest number of series to compare with all boxes."""
        return _MOST_PAIRS // len(self.response)


class Matches(NamedTuple):
    """Best box of each series, int64 (m,), and its correlation, float32 (m,), 0 for no light."""

    box: Index
    correlation: Float


def box_templates(projector: RayDomain, patterns: Float, pixels_across: float) -> BoxTemplates:
    """Average patterns (N, P) over boxes.

    A camera pixel spans about `pixels_across` projector pixels along each axis. Boxes are 1.6 times
    as wide, since it lies anywhere among these, and twice that, for stretched footprints.
    """
    height, width = projector.image_shape
    image = patterns.reshape(height, width, -1)
    responses, centres, widths = [], [], []
    for side in sorted({1.6 * max(1.0, pixels_across) * factor for factor in (1.0, 2.0)}):
        down, across = _box_averages(height, side), _box_averages(width, side)
        rows = np.einsum("ry,yxq->rxq", down, image, optimize=True)
        response = np.einsum("sx,rxq->rsq", across, rows, optimize=True)
        responses.append(response.reshape(-1, patterns.shape[1]))
        centres.append((np.indices(response.shape[:2]).reshape(2, -1).T + 1) / 2)
        widths.append(np.full(len(responses[-1]), side))
    return BoxTemplates(
        projector,
        np.concatenate(responses).astype(np.float32),
        np.concatenate(centres),
        np.concatenate(widths),
    )


def _box_averages(length: int, side: float) -> Double:
    """Compute averages over boxes at half-pixel positions along an axis, (positions, length)."""
    centre, pixel = np.arange(1, 2 * length)[:, None] / 2, np.arange(length)
    overlap = np.minimum(pixel + 1, centre + side / 2) - np.maximum(pixel, centre - side / 2)
    weight = np.clip(overlap, 0, 1)
    averages: Double = weight / weight.sum(axis=1, keepdims=True)
    return averages


def coarse_light(projector: RayDomain, patterns: Float) -> Double:
    """Average patterns (N, P) over coarse cells, minus 1/2: E, (coarse_cells, P)."""
    image = projector.image_shape
    cell = RayDomain(image).square_cells(max(1, round(min(image) / _COARSE_CELLS)))[1]
    size = np.bincount(cell)
    sums = np.zeros((len(size), patterns.shape[1]))
    np.add.at(sums, cell, patterns)
    mean: Double = sums / size[:, None] - 0.5
    return mean


@dataclass(frozen=True)
class MatchedFilter:
    """Box templates, and the matrix that whitens series of P pictures from the right, (P, P)."""

    templates: BoxTemplates
    whitening: Float

    def match(self, series: Float) -> Matches:
        """Compare each series (m, P) with all boxes."""
        boxes = self._whitened(self.templates.response).T
        whitened = self._whitened(series)
        best, score = np.zeros(len(whitened), np.int64), np.zeros(len(whitened), np.float32)
        step = max(1, _BATCH_PRODUCTS // boxes.shape[1])
        for first in range(0, len(whitened), step):
            products = whitened[first : first + step] @ boxes
            largest = products.argmax(axis=1)
            best[first : first + step] = largest
            score[first : first + step] = products[np.arange(len(products)), largest]
        return Matches(best, score)

    def match_image(self, series: Float, camera: RayDomain, mask: Bools) -> Matches:
        """Compare the series (m, P) of the m camera pixels in a mask (M,) with boxes.

        If these are many, only a grid of 2048 pixels is compared with all boxes. The places that
        the grid points around a pixel see, moved by the pixel's distance from them, are guesses for
        the pixel.
        """
        if len(series) <= self.templates.most_series:
            return self.match(series)
        from rfpipe.methods.footprints.kernels import BoxGrid, match_near

        height, width = self.templates.projector.image_shape
        step = max(2, int(np.sqrt(mask.size / (_GRID_PIXELS * camera.views))))
        scale = np.divide((height, width), camera.image_shape)
        guesses = self._guesses(series, camera, mask, step, scale)
        reach = step / 2 * float(scale.max()) + 1.5
        boxes = BoxGrid(self._whitened(self.templates.response), 2 * height - 1, 2 * width - 1)
        return Matches(*match_near(self._whitened(series), boxes, guesses, reach))

    def _guesses(
        self,
        series: Float,
        camera: RayDomain,
        mask: Bools,
        step: int,
        scale: NDArray[np.floating],
    ) -> Double:
        """Compute four places for each camera pixel in the mask, (m, 4, 2), NaN for none.

        Grid points are `step` camera pixels apart; `scale` is the number of projector pixels per
        camera pixel along each axis.
        """
        views, height, width = camera.stack_shape
        view, row, column = np.unravel_index(np.flatnonzero(mask), camera.stack_shape)
        on_grid = (row % step == 0) & (column % step == 0)
        best = self.match(series[on_grid]).box
        grid = np.full((views, height // step + 2, width // step + 2, 2), np.nan)
        place = view[on_grid], row[on_grid] // step, column[on_grid] // step
        grid[place] = self.templates.centre[best]
        guesses = []
        for down in (0, 1):
            for right in (0, 1):
                grid_row, grid_column = row // step + down, column // step + right
                distance = np.stack([row - grid_row * step, column - grid_column * step], axis=1)
                guesses.append(grid[view, grid_row, grid_column] + distance * scale)
        return np.stack(guesses, axis=1)

    def _whitened(self, series: Float) -> Float:
        """Whiten series (m, P), and scale them to length 1; series of zeros stay zero."""
        whitened = series @ self.whitening
        length = np.linalg.norm(whitened, axis=1, keepdims=True)
        unit: Float = np.divide(whitened, length, out=np.zeros_like(whitened), where=length > 0)
        return unit


def matched_filter(templates: BoxTemplates, pictures: ViewPictures) -> MatchedFilter:
    """Compute the filter for the patterns and the noise of pictures, by the module's equation."""
    patterns, relative_noise = pictures.patterns, pictures.relative_noise()
    count = patterns.shape[1]
    E = coarse_light(templates.projector, patterns)
    mean_light = patterns.mean(axis=0, dtype=np.float64) - 0.5
    covariance = (0.1**2 + relative_noise) * np.eye(count) + 5.0**2
    from_far = 0.5**2 * (E.T @ E) / len(E)
    covariance += from_far + 0.14**2 * np.outer(mean_light, mean_light)
    inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    return MatchedFilter(templates, np.ascontiguousarray(inverse.T, np.float32))


def pixels_in_boxes(templates: BoxTemplates, camera_pixels: Index, boxes: Index) -> Index:
    """Return the projector pixels in and around the box of each camera pixel, as sorted keys.

    Keys are ``i N + j``, see `Candidates`; a box is extended by half a pixel on all sides.
    """
    height, width = templates.projector.image_shape
    half = templates.width[boxes] / 2 + 0.5
    low = np.ceil(templates.centre[boxes] - 0.5 - half[:, None]).astype(np.int64)
    high = np.floor(templates.centre[boxes] - 0.5 + half[:, None]).astype(np.int64)
    offset = np.arange(int(2 * half.max(initial=0)) + 1)
    row, column = (low[:, [axis]] + offset for axis in (0, 1))
    row_fits = (row >= 0) & (row <= high[:, :1]) & (row < height)
    column_fits = (column >= 0) & (column <= high[:, 1:]) & (column < width)
    fits = row_fits[:, :, None] & column_fits[:, None, :]
    pixel = row[:, :, None] * width + column[:, None, :]
    keys: Index = (camera_pixels[:, None, None] * templates.projector.size + pixel)[fits]
    return unique_keys(keys)
