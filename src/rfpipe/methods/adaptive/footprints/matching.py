"""Where on the projector each camera pixel's direct light comes from: a whitened matched filter.

Of a scene of which nothing is known, indirect light is about what large parts of a pattern hold.
Patterns are seen through boxes at half-pixel positions; both they and what a pixel shows over time
are whitened against such light before they are compared, so that it makes no match.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.series import Double, Float, Int64, distinct

# Pairs of a pixel and a box up to which all are compared: half a minute of 25 pictures.
_MOST_PAIRS = 2**31


def coarse_light(projector: RayDomain, lit: Float) -> Double:
    """Return the parts of each coarse cell that patterns (N, P) light, less a half, (cells, P).

    Light from far away is told apart in six cells across the short side of an image.
    """
    image = projector.image_shape
    cell = RayDomain(image).squares(max(1, round(min(image) / 6)))[1]
    size = np.bincount(cell)
    sums = np.zeros((len(size), lit.shape[1]))
    np.add.at(sums, cell, lit)
    part: Double = sums / size[:, None] - 0.5
    return part


@dataclass(frozen=True)
class Templates:
    """Patterns on one view as boxes of several widths see them.

    Attributes
    ----------
    projector : RayDomain
    seen : ndarray of float32, shape (n, M)
        What each box sees of the patterns, 0 to 1.
    centre : ndarray of float64, shape (n, 2)
        Row and column, in pixels; the first pixel's centre is at 1/2.
    width : ndarray of float64, shape (n,)
        In pixels.
    """

    projector: RayDomain
    seen: Float
    centre: Double
    width: Double

    @property
    def most_pixels(self) -> int:
        """How many pixels may be compared with all boxes."""
        return _MOST_PAIRS // len(self.seen)

    @classmethod
    def of(cls, projector: RayDomain, lit: Float, density: float) -> Templates:
        """See patterns (N, P) through boxes.

        A camera pixel spans about `density` projector pixels a side. It lies anywhere on them, so
        that a box is somewhat wider; footprints may be stretched to twice that.
        """
        height, width = projector.image_shape
        image = lit.reshape(height, width, -1)
        series, centre, widths = [], [], []
        for side in sorted({1.6 * max(1.0, density) * part for part in (1.0, 2.0)}):
            down, across = _boxes(height, side), _boxes(width, side)
            rows = np.einsum("ay,yxm->axm", down, image, optimize=True)
            response = np.einsum("bx,axm->abm", across, rows, optimize=True)
            series.append(response.reshape(-1, lit.shape[1]))
            centre.append((np.indices(response.shape[:2]).reshape(2, -1).T + 1) / 2)
            widths.append(np.full(len(series[-1]), side))
        return cls(
            projector,
            np.concatenate(series).astype(np.float32),
            np.concatenate(centre),
            np.concatenate(widths),
        )

    def whitener(self, lit: Float, noise: float) -> Float:
        """Return what whitens series of P pictures, by a product from the right, (P, P).

        Against what is left besides, light that is the same in all patterns, light that goes with
        a pattern's mean, and light from far away. `lit` are the patterns (N, P), `noise` a pixel's
        variance relative to its floodlit image squared.
        """
        count = lit.shape[1]
        cells, mean = coarse_light(self.projector, lit), lit.mean(axis=0, dtype=np.float64) - 0.5
        covariance = (0.1**2 + noise) * np.eye(count) + 5.0**2
        covariance += 0.5**2 * (cells.T @ cells) / len(cells) + 0.14**2 * np.outer(mean, mean)
        inverse = np.linalg.inv(np.linalg.cholesky(covariance))
        return np.ascontiguousarray(inverse.T, np.float32)

    def match(self, series: Float, whitener: Float) -> tuple[Int64, Float]:
        """Find the box that each series (pixels, P) resembles most: its number and correlation.

        The latter is -1 to 1; 0 of a black series.
        """
        boxes = _normalised(self.seen @ whitener).T
        whitened = _normalised(series @ whitener)
        best, score = np.zeros(len(whitened), np.int64), np.zeros(len(whitened), np.float32)
        step = max(1, 2**24 // boxes.shape[1])
        for first in range(0, len(whitened), step):
            part = whitened[first : first + step] @ boxes
            chosen = part.argmax(axis=1)
            best[first : first + step] = chosen
            score[first : first + step] = part[np.arange(len(part)), chosen]
        return best, score

    def match_views(
        self, series: Float, whitener: Float, camera: RayDomain, asked: NDArray[np.bool_]
    ) -> tuple[Int64, Float]:
        """Find the box that each asked pixel's series resembles most, as `match` does.

        Of many pixels a grid of 2048 is compared with all boxes, and tells where the others may
        match: neighbours see neighbouring places, or what another neighbour sees. Boxes are those
        of one projector view; `asked` is (camera pixels,).
        """
        from rfpipe.methods.adaptive.footprints.kernels import match_near

        if len(series) <= self.most_pixels:
            return self.match(series, whitener)
        views, height, width = camera.stack_shape
        step = max(2, int(np.sqrt(asked.size / (2048 * views))))
        view, row, column = np.unravel_index(np.flatnonzero(asked), camera.stack_shape)
        on_grid = (row % step == 0) & (column % step == 0)
        best, _ = self.match(series[on_grid], whitener)
        grid = np.full((views, height // step + 2, width // step + 2, 2), np.nan)
        place = view[on_grid], row[on_grid] // step, column[on_grid] // step
        grid[place] = self.centre[best]
        scale = np.divide(self.projector.image_shape, camera.image_shape)
        guesses = []
        for down in (0, 1):
            for right in (0, 1):
                near = row // step + down, column // step + right
                aside = np.stack([row - near[0] * step, column - near[1] * step], axis=1)
                guesses.append(grid[view, near[0], near[1]] + aside * scale)
        boxes, whitened = _normalised(self.seen @ whitener), _normalised(series @ whitener)
        reach = step / 2 * float(scale.max()) + 1.5
        tables = len(self.seen) // len(np.unique(self.width))
        across = 2 * self.projector.image_shape[1] - 1
        return match_near(whitened, boxes, np.stack(guesses, axis=1), reach, tables, across)

    def windows(self, pixels: Int64, boxes: Int64) -> Int64:
        """Return the projector pixels about some pixels' boxes, as sorted keys.

        The key of projector pixel j as seen by camera pixel i is ``i N + j``.
        """
        height, width = self.projector.image_shape
        half = self.width[boxes] / 2 + 0.5
        widest = int(2 * half.max(initial=0)) + 1
        low = np.ceil(self.centre[boxes] - 0.5 - half[:, None]).astype(np.int64)
        high = np.floor(self.centre[boxes] - 0.5 + half[:, None]).astype(np.int64)
        offset = np.arange(widest)
        row, column = (low[:, [axis]] + offset for axis in (0, 1))
        row_fits = (row >= 0) & (row <= high[:, :1]) & (row < height)
        column_fits = (column >= 0) & (column <= high[:, 1:]) & (column < width)
        fits = row_fits[:, :, None] & column_fits[:, None, :]
        ray = row[:, :, None] * width + column[:, None, :]
        keys: NDArray[np.int64] = (pixels[:, None, None] * self.projector.size + ray)[fits]
        return distinct(keys)


def _boxes(length: int, side: float) -> Double:
    """Return boxes at half-pixel positions along an axis, each of sum 1, (positions, length)."""
    centre, pixel = np.arange(1, 2 * length)[:, None] / 2, np.arange(length)
    inside = np.minimum(pixel + 1, centre + side / 2) - np.maximum(pixel, centre - side / 2)
    weight = np.clip(inside, 0, 1)
    boxes: Double = weight / weight.sum(axis=1, keepdims=True)
    return boxes


def _normalised(series: Float) -> Float:
    length = np.linalg.norm(series, axis=1, keepdims=True)
    unit: Float = np.divide(series, length, out=np.zeros_like(series), where=length > 0)
    return unit
