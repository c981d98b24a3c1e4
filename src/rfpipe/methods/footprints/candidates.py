"""Footprints: the projector pixels that may light each camera pixel directly, and how much."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.kernels import apply_precision, marginal, solve_weights
from rfpipe.methods.footprints.matching import Templates, coarse_light
from rfpipe.methods.footprints.series import Series
from rfpipe.methods.footprints.typed import Double, Float, Int64, distinct

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = [
    "Footprints",
    "Precision",
    "first_footprints",
    "found_anew",
    "looked",
    "pruned",
    "reweighted",
]

# Deviations of a weight about 0, as fractions of the floodlit image: before anything is known, of
# what has been found, of its surroundings, after pruning, and at least.
_UNKNOWN, _FOUND, _NEW, _PRUNED, _LEAST = 1 / 4, 0.03, 0.05, 0.02, 1e-4
# Weights that count: for a search around them, and at the end; fractions of the floodlit image.
_KEPT, _SIGNIFICANT = 0.01, 0.005
# What explains less than so many squared standard deviations is no footprint.
_EVIDENCE = 12.0
# Another footprint has this evidence, and explains so much of what is left.
_ANOTHER, _EXPLAINS = 25.0, 0.25
# What the model may be wrong by where weights are found, as a fraction of the floodlit image.
_WRONG = 0.003
# Deviation of indirect light at first, as a fraction of the floodlit image.
_INDIRECT = 0.2


@dataclass(frozen=True)
class Footprints:
    """Candidates of each camera pixel, and their weights.

    Attributes
    ----------
    keys : ndarray of int64, shape (n,)
        ``i N + j`` for projector pixel j of N as a candidate of camera pixel i; ascending.
    variance : ndarray of float32, shape (n,)
        Of each weight about 0, as it is expected.
    weights : ndarray of float32, shape (n,)
        Radiance, at least 0.
    """

    keys: Int64
    variance: Float
    weights: Float

    def pixels(self, rays: int) -> Int64:
        """Return the candidates' camera pixels, of a projector of so many rays."""
        return self.keys // rays

    def starts(self, pixels: int, rays: int) -> Int64:
        """Return where each camera pixel's candidates begin, (pixels + 1,)."""
        return np.searchsorted(self.keys, np.arange(pixels + 1) * rays)

    def matrix(self, pixels: int, rays: int) -> csr_array[np.float32]:
        """Return the weights as a sparse matrix (pixels, rays)."""
        from scipy.sparse import csr_array

        columns = (self.keys % rays).astype(np.int32)
        starts = self.starts(pixels, rays).astype(np.int32)
        return csr_array((self.weights, columns, starts), shape=(pixels, rays))

    def uncertain(self, series: Series, part: float, part_of_all: float) -> Footprints:
        """Return them with deviations of parts of the weight and of the floodlit image, squared."""
        floodlit = series.floodlit[self.pixels(len(series.lit))]
        variance = np.square(part * self.weights) + np.square(part_of_all * floodlit)
        return replace(self, variance=variance.astype(np.float32))


@dataclass(frozen=True)
class Precision:
    """Inverse covariance of each pixel's pictures when the weights of its footprint are unknown.

    Attributes
    ----------
    trace : ndarray of float32, shape (pixels,)
    sizes : ndarray of int64, shape (pixels,)
        Candidates of each pixel.
    """

    starts: Int64
    factors: Double
    certainty: Float
    trace: Float

    @classmethod
    def of(cls, series: Series, found: Footprints) -> Precision:
        """Marginalise the weights of footprints."""
        rays, pixels = len(series.lit), len(series.seen)
        starts = found.starts(pixels, rays)
        own = (found.keys % rays).astype(np.int32)
        least = np.square(1e-3 * series.floodlit[found.pixels(rays)])
        # of a pixel that is black, too, which only the other way has made a candidate
        least = np.maximum(least, np.finfo(np.float32).tiny)
        variance = np.maximum(found.variance, least).astype(np.float32)
        certainty = series.certainty()
        factors, trace = marginal(starts, own, variance, series.lit, certainty)
        return cls(starts, factors, certainty, trace)

    @property
    def sizes(self) -> Int64:
        """Candidates of each pixel, (pixels,)."""
        return np.diff(self.starts)

    def applied(self, seen: Float) -> Float:
        """Return the precision times pictures (pixels, M)."""
        pictures = np.ascontiguousarray(seen, np.float32)
        return apply_precision(self.starts, self.factors, self.certainty, pictures)


def first_footprints(
    series: Series, camera: RayDomain, projector: RayDomain, templates: Templates
) -> Footprints:
    """Find footprints of which nothing is known, taking indirect light for what is smooth."""
    rays, lit = len(series.lit), series.lit
    floodlit = series.floodlit
    there = series.shining
    shining = np.flatnonzero(there)
    whitener = templates.whitener(lit, series.relative_noise())
    own = series.seen[shining] / floodlit[shining, None]
    best, score = templates.match_views(own, whitener, camera, there)
    keys = templates.windows(shining[score > 0], best[score > 0])
    variance = np.square(_UNKNOWN * floodlit[keys // rays])
    found = Footprints(keys, variance.astype(np.float32), np.zeros(len(keys), np.float32))
    # what smooth light does over time, and how strongly: pictures are turned into its axes
    cells = coarse_light(projector, lit) + 0.5
    strength, axes = np.linalg.eigh(cells.T @ cells / len(cells))
    smooth = np.square(_INDIRECT * floodlit)[:, None] * np.maximum(strength, 0)
    known = series.known[:, None]
    own = np.where(known, 1 / np.maximum(series.certainty(_WRONG), np.finfo(np.float32).tiny), 1)
    certainty = np.where(known, 1 / (own.mean(axis=1, keepdims=True) + smooth), 0)
    turned = (x.astype(np.float32) for x in (lit @ axes, certainty, series.seen @ axes))
    return _weighed(found, floodlit, *turned)


def reweighted(
    series: Series, found: Footprints, indirect: Float, expected: Float | None = None
) -> Footprints:
    """Find the weights anew in what indirect light leaves of the pictures.

    Parameters
    ----------
    series : Series
    found : Footprints
    indirect : ndarray of float32, shape (pixels, M)
    expected : ndarray of float32, shape (candidates,), optional
        About what weights are as uncertain as `found` has it; 0 by default.
    """
    seen = (series.seen - indirect).astype(np.float32)
    certainty = series.certainty(_WRONG)
    again = _weighed(found, series.floodlit, series.lit, certainty, seen, expected)
    return again.uncertain(series, 1.0, _FOUND)


def found_anew(
    series: Series, found: Footprints, indirect: Float, templates: Templates
) -> Footprints:
    """Look again: around what was found, and where what is left over shows another footprint."""
    rays, pixels, floodlit = len(series.lit), len(series.seen), series.floodlit
    strong = found.weights > _KEPT * floodlit[found.pixels(rays)]
    keys = [_surroundings(found.keys[strong], templates.projector)]
    left = series.seen - indirect - found.matrix(pixels, rays) @ series.lit
    certainty = series.certainty(_WRONG)
    rest = np.einsum("im,im,im->i", certainty, left, left)
    asked = np.flatnonzero(series.shining & (rest > max(_ANOTHER, left.shape[1] / 2)))
    most = templates.most_pixels
    if len(asked) > most:
        asked = np.sort(asked[np.argsort(-rest[asked], kind="stable")[:most]])
    if len(asked):
        whitener = templates.whitener(series.lit, series.relative_noise())
        best, score = templates.match(left[asked] / floodlit[asked, None], whitener)
        box, weight = templates.seen[best], certainty[asked]
        gain = np.square(np.einsum("im,im,im->i", weight, left[asked], box))
        gain /= np.maximum(np.einsum("im,im,im->i", weight, box, box), np.finfo(np.float32).tiny)
        there = (score > 0) & (gain > _ANOTHER) & (gain > _EXPLAINS * rest[asked])
        keys.append(templates.windows(asked[there], best[there]))
    together = distinct(np.concatenate(keys))
    weights = np.zeros(len(together), np.float32)
    place = np.searchsorted(together, found.keys[strong])
    weights[place] = found.weights[strong]
    least = _NEW * floodlit[together // rays]
    variance = np.square(np.maximum(weights, least)).astype(np.float32)
    return Footprints(together, variance, weights)


def looked(series: Series, found: Footprints, chosen: Int64 | None) -> tuple[Series, Footprints]:
    """Return the pictures and footprints of chosen camera pixels, ascending; None for all."""
    if chosen is None:
        return series, found
    rays = len(series.lit)
    pixels, place = found.pixels(rays), np.full(len(series.seen), -1)
    place[chosen] = np.arange(len(chosen))
    kept = place[pixels] >= 0
    keys = place[pixels[kept]] * rays + found.keys[kept] % rays
    return series.of(chosen), Footprints(keys, found.variance[kept], found.weights[kept])


def pruned(series: Series, found: Footprints) -> Footprints:
    """Drop candidates that turned out to give no light."""
    floodlit = series.floodlit[found.pixels(len(series.lit))]
    kept = found.weights > _SIGNIFICANT * floodlit
    left = Footprints(found.keys[kept], found.variance[kept], found.weights[kept])
    return left.uncertain(series, 1.0, _PRUNED)


def _weighed(
    found: Footprints,
    floodlit: Float,
    lit: Float,
    certainty: Float,
    seen: Float,
    expected: Float | None = None,
) -> Footprints:
    """Return footprints with the non-negative weights that explain what is seen best."""
    rays = len(lit)
    least = np.square(_LEAST * floodlit[found.pixels(rays)])
    # a black pixel's candidate, which only the other way has, has no deviation at all
    variance = np.maximum(found.variance + least, np.finfo(np.float32).tiny)
    ridge = (1 / variance).astype(np.float32)
    lit, certainty, seen = (np.ascontiguousarray(each) for each in (lit, certainty, seen))
    own = (found.keys % rays).astype(np.int32)
    starts = found.starts(len(seen), rays)
    about = np.zeros_like(ridge) if expected is None else expected
    weights = solve_weights(starts, own, ridge, about, lit, certainty, seen, _EVIDENCE)
    return replace(found, weights=weights)


def _surroundings(keys: Int64, projector: RayDomain) -> Int64:
    """Return candidates and their eight neighbours, as sorted keys."""
    _, height, width = projector.stack_shape
    row, column = keys // width % height, keys % width
    around = [keys[:0]]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            row_fits = (row + down >= 0) & (row + down < height)
            fits = row_fits & (column + right >= 0) & (column + right < width)
            around.append(keys[fits] + down * width + right)
    return distinct(np.concatenate(around))
