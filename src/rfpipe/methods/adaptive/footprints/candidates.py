"""Footprints: the projector pixels that may light each camera pixel directly, and how much."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.matching import Templates, coarse_light
from rfpipe.methods.adaptive.footprints.series import Double, Float, Int64, Series, distinct

if TYPE_CHECKING:
    from scipy.sparse import csr_array


# What explains less than so many squared standard deviations is no footprint; another footprint,
# in what is left over, explains more.
_EVIDENCE, _ANOTHER = 12.0, 25.0
# What the model may be wrong by where weights are found, as a fraction of the floodlit image.
_WRONG = 0.003
_TINY = np.finfo(np.float32).tiny


@dataclass(frozen=True)
class Candidates:
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

    def matrix(self, pixels: int, rays: int, values: NDArray[Any] | None = None) -> csr_array[Any]:
        """Return the weights, or other values, as a sparse matrix (pixels, rays)."""
        from scipy.sparse import csr_array

        values = self.weights if values is None else values
        columns = (self.keys % rays).astype(np.int32)
        starts = self.starts(pixels, rays).astype(np.int32)
        return csr_array((values, columns, starts), shape=(pixels, rays))

    def uncertain(self, series: Series, part: float, part_of_all: float) -> Candidates:
        """Return them with deviations of parts of the weight and of the floodlit image, squared."""
        floodlit = series.floodlit[self.pixels(len(series.lit))]
        variance = np.square(part * self.weights) + np.square(part_of_all * floodlit)
        return replace(self, variance=variance.astype(np.float32))

    def brighter(self, series: Series, but: Int64 | None = None) -> Candidates:
        """Leave those out that give next to no light, but for those of some pixels."""
        pixels = self.pixels(len(series.lit))
        held = self.weights > 0.005 * series.floodlit[pixels]
        if but is not None:
            chosen = np.zeros(len(series.observed), np.bool_)
            chosen[but] = True
            held |= chosen[pixels]
        return Candidates(self.keys[held], self.variance[held], self.weights[held])

    def looked_at(self, series: Series, chosen: Int64 | None) -> tuple[Series, Candidates]:
        """Return the pictures and candidates of chosen camera pixels, ascending; None for all."""
        if chosen is None:
            return series, self
        rays = len(series.lit)
        pixels, place = self.pixels(rays), np.full(len(series.observed), -1)
        place[chosen] = np.arange(len(chosen))
        held = place[pixels] >= 0
        keys = place[pixels[held]] * rays + self.keys[held] % rays
        return series.of(chosen), Candidates(keys, self.variance[held], self.weights[held])

    def weighed(
        self,
        floodlit: Float,
        lit: Float,
        certainty: Float,
        observed: Float,
        expected: Float | None = None,
    ) -> Candidates:
        """Return them with the non-negative weights that explain what is observed best.

        The search begins at the weights that they have, which saves time alone.
        """
        from rfpipe.methods.adaptive.footprints.kernels import solve_weights

        rays = len(lit)
        least = np.square(1e-4 * floodlit[self.pixels(rays)])
        # a black pixel's candidate, which only the other way has, has no deviation at all
        ridge = (1 / np.maximum(self.variance + least, _TINY)).astype(np.float32)
        lit, certainty, observed = map(np.ascontiguousarray, (lit, certainty, observed))
        ray = (self.keys % rays).astype(np.int32)
        starts = self.starts(len(observed), rays)
        about = np.zeros_like(ridge) if expected is None else expected
        weights = solve_weights(
            starts, ray, ridge, about, self.weights, lit, certainty, observed, _EVIDENCE
        )
        return replace(self, weights=weights)


@dataclass(frozen=True)
class Precision:
    """Inverse covariance of each pixel's pictures when the weights of its footprint are unknown.

    Attributes
    ----------
    trace : ndarray of float32, shape (pixels,)
    """

    starts: Int64
    factors: Double
    certainty: Float
    trace: Float

    @classmethod
    def of(cls, series: Series, found: Candidates) -> Precision:
        """Marginalise the weights of footprints."""
        from rfpipe.methods.adaptive.footprints.kernels import marginal

        rays, pixels = len(series.lit), len(series.observed)
        starts = found.starts(pixels, rays)
        ray = (found.keys % rays).astype(np.int32)
        least = np.square(1e-3 * series.floodlit[found.pixels(rays)])
        # of a pixel that is black, too, which only the other way has made a candidate
        variance = np.maximum(found.variance, np.maximum(least, _TINY)).astype(np.float32)
        certainty = series.certainty()
        factors, trace = marginal(starts, ray, variance, series.lit, certainty)
        return cls(starts, factors, certainty, trace)

    def applied(self, observed: Float) -> Float:
        """Return the precision times pictures (pixels, P)."""
        from rfpipe.methods.adaptive.footprints.kernels import apply_precision

        pictures = np.ascontiguousarray(observed, np.float32)
        return apply_precision(self.starts, self.factors, self.certainty, pictures)


def first_footprints(series: Series, camera: RayDomain, templates: Templates) -> Candidates:
    """Find footprints of which nothing is known, taking indirect light for what is smooth.

    Weights deviate by a quarter of the floodlit image, indirect light by a fifth.
    """
    rays, lit = len(series.lit), series.lit
    floodlit, there = series.floodlit, series.shining
    shining = np.flatnonzero(there)
    whitener = templates.whitener(lit, series.relative_noise())
    share = series.observed[shining] / floodlit[shining, None]
    best, score = templates.match_views(share, whitener, camera, there)
    keys = templates.windows(shining[score > 0], best[score > 0])
    variance = np.square(1 / 4 * floodlit[keys // rays])
    candidates = Candidates(keys, variance.astype(np.float32), np.zeros(len(keys), np.float32))
    # what smooth light does over time, and how strongly: pictures are turned into its axes
    cells = coarse_light(templates.projector, lit) + 0.5
    strength, axes = np.linalg.eigh(cells.T @ cells / len(cells))
    smooth = np.square(0.2 * floodlit)[:, None] * np.maximum(strength, 0)
    known = series.known[:, None]
    noise = np.where(known, 1 / np.maximum(series.certainty(_WRONG), _TINY), 1)
    certainty = np.where(known, 1 / (noise.mean(axis=1, keepdims=True) + smooth), 0)
    turned = (x.astype(np.float32) for x in (lit @ axes, certainty, series.observed @ axes))
    return candidates.weighed(floodlit, *turned)


def reweighted(
    series: Series, found: Candidates, indirect: Float, expected: Float | None = None
) -> Candidates:
    """Find the weights anew in what indirect light (pixels, P) leaves of the pictures.

    They lie about what is `expected` (candidates,), or 0, as uncertain as `found` has it.
    """
    residual = (series.observed - indirect).astype(np.float32)
    again = found.weighed(series.floodlit, series.lit, series.certainty(_WRONG), residual, expected)
    return again.uncertain(series, 1.0, 0.03)


def found_anew(
    series: Series, found: Candidates, indirect: Float, camera: RayDomain, templates: Templates
) -> Candidates:
    """Look again: around what was found, what neighbours see, and what is left over shows."""
    rays, pixels, floodlit = len(series.lit), len(series.observed), series.floodlit
    strong = found.weights > 0.01 * floodlit[found.pixels(rays)]
    neighbours = _neighbours(found.keys[strong], found.weights[strong], camera, rays)
    beside = distinct((np.arange(pixels) * rays + neighbours)[neighbours >= 0])
    beside = beside[_support(beside, neighbours, templates) > 1 / 8]  # more than one of them
    together = np.concatenate([found.keys[strong], beside])
    keys = [_surroundings(together, templates.projector)]
    residual = series.observed - indirect - found.matrix(pixels, rays) @ series.lit
    certainty = series.certainty(_WRONG)
    rest = np.einsum("im,im,im->i", certainty, residual, residual)
    pixel = np.flatnonzero(series.shining & (rest > max(_ANOTHER, residual.shape[1] / 2)))
    if len(pixel) > templates.most_pixels:
        pixel = np.sort(pixel[np.argsort(-rest[pixel], kind="stable")[: templates.most_pixels]])
    whitener = templates.whitener(series.lit, series.relative_noise())
    best, score = templates.match(residual[pixel] / floodlit[pixel, None], whitener)
    box, weight = templates.seen[best], certainty[pixel]
    gain = np.square(np.einsum("im,im,im->i", weight, residual[pixel], box))
    gain /= np.maximum(np.einsum("im,im,im->i", weight, box, box), _TINY)
    there = (score > 0) & (gain > _ANOTHER) & (gain > 0.25 * rest[pixel])
    keys.append(templates.windows(pixel[there], best[there]))
    together = distinct(np.concatenate(keys))
    weights = np.zeros(len(together), np.float32)
    weights[np.searchsorted(together, found.keys[strong])] = found.weights[strong]
    # two places may have the same patterns: what neighbours see is the more likely
    support = _support(together, neighbours, templates)
    least = (0.05 + 0.2 * support) * floodlit[together // rays]
    deviation = np.maximum(weights * support, least)
    return Candidates(together, np.square(deviation).astype(np.float32), weights)


def _neighbours(keys: Int64, weights: Float, camera: RayDomain, rays: int) -> Int64:
    """Return what gives each camera pixel's neighbours most light, (8, pixels); -1 for nothing."""
    order = np.argsort(weights, kind="stable")
    strongest = np.full(camera.size, -1)
    strongest[keys[order] // rays] = keys[order] % rays  # the last one stays
    _, height, width = camera.stack_shape
    image = strongest.reshape(camera.stack_shape)
    image = np.pad(image, ((0, 0), (1, 1), (1, 1)), constant_values=-1)
    around = [place for place in np.ndindex(3, 3) if place != (1, 1)]
    shifted = [image[:, down : down + height, right : right + width] for down, right in around]
    return np.stack(shifted).reshape(8, -1)


def _support(keys: Int64, neighbours: Int64, templates: Templates) -> Float:
    """Return which part of a pixel's neighbours see a candidate, or beside it, 0 to 1.

    Of some 24 patterns, one pixel in a hundred resembles another place more than its own by chance.
    """
    projector, reach = templates.projector, templates.width.min()
    width = projector.image_shape[1]
    pixel, ray = np.divmod(keys, projector.size)
    row, column = np.divmod(ray, width)
    support = np.zeros(len(keys), np.float32)
    for down, right in zip(*np.divmod(neighbours, width), strict=True):
        near = (down[pixel] >= 0) & (abs(row - down[pixel]) <= reach)
        support += near & (abs(column - right[pixel]) <= reach)
    return support / np.float32(len(neighbours))


def _surroundings(keys: Int64, projector: RayDomain) -> Int64:
    """Return candidates and their eight neighbours, as sorted keys."""
    height, width = projector.image_shape
    row, column = keys // width % height, keys % width
    around = [keys[:0]]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            row_fits = (row + down >= 0) & (row + down < height)
            fits = row_fits & (column + right >= 0) & (column + right < width)
            around.append(keys[fits] + down * width + right)
    return distinct(np.concatenate(around))


def joined(parts: list[Candidates], rays: int) -> Candidates:
    """Put together the footprints on a projector's views, of so many rays each."""
    views = len(parts)
    if views == 1:
        return parts[0]
    keys = np.concatenate(
        [
            part.keys + (part.keys // rays * (views - 1) + view) * rays
            for view, part in enumerate(parts)
        ]
    )
    order = np.argsort(keys, kind="stable")
    variance, weights = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("variance", "weights")
    )
    return Candidates(keys[order], variance, weights)


def by_view(views: tuple[Series, ...], found: Candidates) -> Iterator[tuple[Series, Candidates]]:
    """Yield the series of each of a projector's views, and the footprints on it."""
    if len(views) == 1:
        yield views[0], found
        return
    for number, series in enumerate(views):
        yield series, on_view(found, number, len(views), len(series.lit))


def on_view(found: Candidates, view: int, views: int, rays: int) -> Candidates:
    """Return the footprints on one of a projector's views, of so many rays each."""
    mask = found.keys % (views * rays) // rays == view
    keys = found.keys[mask]
    keys -= (keys // (views * rays) * (views - 1) + view) * rays
    return Candidates(keys, found.variance[mask], found.weights[mask])


def is_symmetric(found: Candidates, rays: int) -> bool:
    """Tell whether footprints between the same rays of both sides differ by less than half.

    Where a rig isn't coaxial they have nothing in common.
    """
    there, back = _both_ways(found, rays)
    apart = np.linalg.norm(there.weights - back)
    return bool(apart < 0.5 * np.linalg.norm(there.weights))


def with_other_way(found: Candidates, rays: int) -> Candidates:
    """Return footprints with those candidates, too, that the other way found."""
    return _both_ways(found, rays)[0]


def averaged(found: Candidates, rays: int) -> Candidates:
    """Return the means of both ways."""
    there, back = _both_ways(found, rays)
    return replace(there, weights=((there.weights + back) / 2).astype(np.float32))


def reconciled(series: tuple[Series, ...], found: Candidates, indirect: list[Float]) -> Candidates:
    """Find weights anew in what indirect light leaves, near those of the other way.

    The two may differ by a tenth of the weight and .003 of the floodlit image.
    """
    rays = len(series[0].lit)
    there, back = _both_ways(found, rays * len(series))
    expected = by_view(series, replace(there, weights=back))
    parts = []
    for (each, other), light in zip(expected, indirect, strict=True):
        near = other.uncertain(each, 0.1, 0.003)
        parts.append(reweighted(each, near, light, near.weights))
    return joined(parts, rays)


def _both_ways(found: Candidates, rays: int) -> tuple[Candidates, Float]:
    """Add the candidates to which only the other way gives light; return its weights, too.

    The larger variance counts.
    """
    numbers = found.matrix(rays, rays, np.arange(len(found.keys), dtype=np.int32))
    order = numbers.tocsc().data
    back = (found.keys % rays * rays + found.keys // rays)[order]
    weights, spread = found.weights[order], found.variance[order]
    keys = distinct(np.concatenate([found.keys, back[weights > 0]]))
    place, other = np.searchsorted(keys, found.keys), np.searchsorted(keys, back)
    known = keys[np.minimum(other, len(keys) - 1)] == back
    other = other[known]
    variance, there, light = np.zeros((3, len(keys)), np.float32)
    there[place], light[other] = found.weights, weights[known]
    variance[place] = found.variance
    variance[other] = np.maximum(variance[other], spread[known])
    return Candidates(keys, variance, there), light
