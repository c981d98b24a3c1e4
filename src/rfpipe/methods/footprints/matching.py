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

The response t of a box is an average over projector pixels, and so is its product with a series.
Therefore the products of a series with all pixels are computed, and averaged over boxes; responses
of all boxes, eight times as many as pixels, are never in memory together.

===============  =========================  =================  =====================================
symbol           name in the code           shape              meaning
===============  =========================  =================  =====================================
``y``            `series`                   (m, P)             radiance of m camera pixels over
                                                               their floodlit radiance
``t``            `Boxes.responses`          (boxes, P)         mean of each pattern over each box,
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
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import unique_keys
from rfpipe.methods.footprints.pictures import ViewPictures
from rfpipe.ranges import ranges

if TYPE_CHECKING:
    from rfpipe.methods.footprints.matching_kernels import AxisAverages

# Largest number of pairs of a series and a box to compare: about 4 s.
_MOST_PAIRS = 2**30
# Products of series and projector pixels computed in one batch, and series compared in one batch.
_BATCH_PRODUCTS, _BATCH_SERIES = 2**24, 2**17
# Pixels of the coarse grid that are compared with all boxes, in each camera view: of one view, and
# of several.
_GRID_PIXELS, _GRID_PIXELS_OF_VIEW = 2048, 512
# Largest spacing of the grid from which all other pixels are guessed.
_LARGEST_STEP = 8
# Cells of coarse light along the short side of the projector's image.
_COARSE_CELLS = 6


@dataclass(frozen=True)
class Boxes:
    """Boxes of two widths at half-pixel positions of the image of a projector view.

    They are numbered by width, row and column.

    Attributes
    ----------
    projector : RayDomain
        Of the view.
    widths : tuple of float
        In pixels, ascending.
    """

    projector: RayDomain
    widths: tuple[float, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of widths, rows and columns."""
        height, width = self.projector.image_shape
        return len(self.widths), 2 * height - 1, 2 * width - 1

    @property
    def most_series(self) -> int:
        """Largest number of series to compare with all boxes."""
        return _MOST_PAIRS // int(np.prod(self.shape))

    @cached_property
    def averages(self) -> tuple[AxisAverages, ...]:
        """Averages over the boxes of each width along an axis, the same for both axes."""
        return tuple(map(_averages, self.widths))

    def centre(self, boxes: Index) -> Double:
        """Return row and column of boxes, (m, 2), in pixels; the first pixel's centre is at 1/2."""
        _, row, column = np.unravel_index(boxes, self.shape)
        return (np.stack([row, column], axis=1) + 1) / 2

    def width(self, boxes: Index) -> Double:
        """Return the widths of boxes, (m,), in pixels."""
        return np.asarray(self.widths)[np.unravel_index(boxes, self.shape)[0]]

    def responses(self, boxes: Index, patterns: Float) -> Float:
        """Average patterns (N, P) over boxes (m,): t, (m, P); 0 outside the image."""
        from rfpipe.methods.footprints.matching_kernels import box_responses

        image = patterns.reshape(*self.projector.image_shape, -1)
        responses = np.empty((len(boxes), patterns.shape[1]), np.float32)
        number, row, column = np.unravel_index(boxes, self.shape)
        for width, averages in enumerate(self.averages):
            index = np.flatnonzero(number == width)
            responses[index] = box_responses(image, averages, row[index], column[index])
        return responses


class Matches(NamedTuple):
    """Best box of each series, int64 (m,), and its correlation, float32 (m,), 0 for no light."""

    box: Index
    correlation: Float


def boxes_of(projector: RayDomain, pixels_across: float) -> Boxes:
    """Return the boxes for camera pixels that span some projector pixels along each axis.

    Boxes are 1.6 times as wide, since a camera pixel lies anywhere among these, and twice that, for
    stretched footprints.
    """
    side = 1.6 * max(1.0, pixels_across)
    return Boxes(projector, (side, 2 * side))


def _averages(side: float) -> AxisAverages:
    """Compute the averages over boxes at half-pixel positions along an axis."""
    from rfpipe.methods.footprints.matching_kernels import AxisAverages

    centre = np.array([[0.5], [1.0]])
    shift = np.floor(centre - side / 2).astype(np.int64)
    pixel = shift + np.arange(int(side) + 2)
    overlap = np.minimum(pixel + 1, centre + side / 2) - np.maximum(pixel, centre - side / 2)
    return AxisAverages(shift[:, 0], (np.clip(overlap, 0, 1) / side).astype(np.float32))


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
    """Boxes with their whitened light, for series of P pictures.

    Attributes
    ----------
    boxes : Boxes
    whitening : ndarray of float32, shape (P, P)
        ``Q^-T``; it whitens series from the right.
    pixels : ndarray of float32, shape (N, P)
        Whitened light of each projector pixel in the patterns.
    scales : ndarray of float32, shape (widths, rows, 2, W)
        ``1 / |Q^-1 t|`` of the box in column ``2 k + parity``, at ``[width, row, parity, k]``; 0
        for a box without light.
    """

    boxes: Boxes
    whitening: Float
    pixels: Float
    scales: Float

    def match(self, series: Float) -> Matches:
        """Compare each series (m, P) with all boxes."""
        from rfpipe.methods.footprints.matching_kernels import match_all

        whitened, averages = self._whitened(series), self.boxes.averages
        image, step = self.boxes.projector.image_shape, max(1, _BATCH_PRODUCTS // len(self.pixels))
        parts = [
            match_all((part @ self.pixels.T).reshape(-1, *image), averages, self.scales)
            for part in np.split(whitened, range(step, len(whitened), step))
        ]
        return Matches(*map(np.concatenate, zip(*parts, strict=True)))

    def match_image(self, pictures: ViewPictures, camera: RayDomain) -> Matches:
        """Compare the series of all lit camera pixels with boxes.

        If these are many, only a grid of 2048 pixels, or 512 in each of several views, is compared
        with all boxes. The places that the grid points around a pixel see, moved by the pixel's
        distance from them, are guesses for the pixel. If the points are far apart, a finer grid is
        matched first by such guesses.
        """
        lit = np.flatnonzero(pictures.lit_pixels)
        if len(lit) <= self.boxes.most_series:
            return self.match(relative_series(pictures, lit))
        of_view = _GRID_PIXELS if camera.views == 1 else _GRID_PIXELS_OF_VIEW
        step = max(2, int(np.sqrt(camera.size / (of_view * camera.views))))
        known = _on_grid(lit, camera, step)
        matches = self.match(relative_series(pictures, known))
        while step > 1:
            grid = _Grid.of(camera, step, known, self.boxes.centre(matches.box))
            step = step // 4 if step > _LARGEST_STEP else 1
            known = _on_grid(lit, camera, step)
            matches = self._match_near(pictures, known, grid)
        return matches

    def _match_near(self, pictures: ViewPictures, pixels: Index, grid: _Grid) -> Matches:
        """Compare the series of camera pixels (m,) with boxes near the places of grid points."""
        from rfpipe.methods.footprints.matching_kernels import match_near

        image = self.pixels.reshape(*self.boxes.projector.image_shape, -1)
        scale = np.divide(image.shape[:2], grid.camera.image_shape)
        reach = grid.step / 2 * float(scale.max()) + 1.5
        parts = []
        for first, last in ranges(len(pixels), _BATCH_SERIES):
            part = pixels[first:last]
            series = self._whitened(relative_series(pictures, part))
            guesses = grid.guesses(part, scale)
            parts.append(
                match_near(series, image, self.boxes.averages, self.scales, guesses, reach)
            )
        return Matches(*map(np.concatenate, zip(*parts, strict=True)))

    def _whitened(self, series: Float) -> Float:
        """Whiten series (m, P), and scale them to length 1; series of zeros stay zero."""
        whitened = series @ self.whitening
        length = np.linalg.norm(whitened, axis=1, keepdims=True)
        unit: Float = np.divide(whitened, length, out=np.zeros_like(whitened), where=length > 0)
        return unit


def relative_series(pictures: ViewPictures, camera_pixels: Index) -> Float:
    """Return the series of lit camera pixels (m,): radiance over floodlit radiance, (m, P)."""
    part = pictures.at(camera_pixels)
    return part.radiance / part.floodlit[:, None]


def _on_grid(pixels: Index, camera: RayDomain, step: int) -> Index:
    """Select the camera pixels whose row and column are multiples of `step`."""
    _, row, column = np.unravel_index(pixels, camera.stack_shape)
    on_grid: Index = pixels[(row % step == 0) & (column % step == 0)]
    return on_grid


@dataclass(frozen=True)
class _Grid:
    """Places that a grid of camera pixels sees in the projector's image.

    Attributes
    ----------
    camera : RayDomain
    step : int
        Spacing of the grid in camera pixels.
    places : ndarray of float64, shape (views, rows, columns, 2)
        Row and column in projector pixels; NaN for an unknown place.
    """

    camera: RayDomain
    step: int
    places: Double

    @classmethod
    def of(cls, camera: RayDomain, step: int, pixels: Index, places: Double) -> _Grid:
        """Make the grid of the places (m, 2) of camera pixels (m,) on it."""
        views, height, width = camera.stack_shape
        grid = np.full((views, height // step + 2, width // step + 2, 2), np.nan)
        view, row, column = np.unravel_index(pixels, camera.stack_shape)
        grid[view, row // step, column // step] = places
        return cls(camera, step, grid)

    def guesses(self, pixels: Index, scale: NDArray[np.floating]) -> Double:
        """Compute four places for each camera pixel, (m, 4, 2), NaN for none.

        `scale` is the number of projector pixels per camera pixel along each axis.
        """
        view, row, column = np.unravel_index(pixels, self.camera.stack_shape)
        guesses = np.empty((len(pixels), 4, 2))
        for number, (down, right) in enumerate(np.ndindex(2, 2)):
            grid_row, grid_column = row // self.step + down, column // self.step + right
            distance = np.stack(
                [row - grid_row * self.step, column - grid_column * self.step], axis=1
            )
            guesses[:, number] = self.places[view, grid_row, grid_column] + distance * scale
        return guesses


def matched_filter(boxes: Boxes, pictures: ViewPictures) -> MatchedFilter:
    """Compute the filter for the patterns and the noise of pictures, by the module's equation."""
    from rfpipe.methods.footprints.matching_kernels import box_lengths

    patterns, relative_noise = pictures.patterns, pictures.relative_noise()
    count = patterns.shape[1]
    E = coarse_light(boxes.projector, patterns)
    mean_light = patterns.mean(axis=0, dtype=np.float64) - 0.5
    covariance = (0.1**2 + relative_noise) * np.eye(count) + 5.0**2
    from_far = 0.5**2 * (E.T @ E) / len(E)
    covariance += from_far + 0.14**2 * np.outer(mean_light, mean_light)
    inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    whitening = np.ascontiguousarray(inverse.T, np.float32)
    pixels = patterns @ whitening
    image = pixels.reshape(*boxes.projector.image_shape, -1)
    lengths = np.stack([box_lengths(image, averages) for averages in boxes.averages])
    scales = np.divide(1, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    return MatchedFilter(boxes, whitening, pixels, scales)


def pixels_in_boxes(boxes: Boxes, camera_pixels: Index, numbers: Index) -> Index:
    """Return the projector pixels in and around the box of each camera pixel, as sorted keys.

    Keys are ``i N + j``, see `Candidates`; a box is extended by half a pixel on all sides.
    """
    height, width = boxes.projector.image_shape
    half = boxes.width(numbers) / 2 + 0.5
    low = np.ceil(boxes.centre(numbers) - 0.5 - half[:, None]).astype(np.int64)
    high = np.floor(boxes.centre(numbers) - 0.5 + half[:, None]).astype(np.int64)
    offset = np.arange(int(2 * half.max(initial=0)) + 1)
    row, column = (low[:, [axis]] + offset for axis in (0, 1))
    row_fits = (row >= 0) & (row <= high[:, :1]) & (row < height)
    column_fits = (column >= 0) & (column <= high[:, 1:]) & (column < width)
    fits = row_fits[:, :, None] & column_fits[:, None, :]
    pixel = row[:, :, None] * width + column[:, None, :]
    keys: Index = (camera_pixels[:, None, None] * boxes.projector.size + pixel)[fits]
    return unique_keys(keys)
