"""Candidates between the views of a light field: what each way says of the other.

Where cameras and projectors share their rays, the light from ray j to ray i is that from i to j,
and the two are measured in different pictures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.methods.adaptive.footprints.candidates import Candidates, reweighted
from rfpipe.methods.adaptive.footprints.series import Float, Int64, Series


@dataclass(frozen=True)
class _Ways:
    """Candidates of either way, in order of their keys, and the weights both ways."""

    keys: Int64
    there: Float
    back: Float
    variance: Float


def joined(parts: list[Candidates], rays: int) -> Candidates:
    """Put together the footprints on a projector's views, of so many rays each."""
    views = len(parts)
    if views == 1:
        return parts[0]
    pixels = 1 + max((int(part.keys[-1]) // rays for part in parts if len(part.keys)), default=-1)
    starts = [part.starts(pixels, rays) for part in parts]
    begins = np.sum(starts, axis=0)[:-1]
    keys = np.empty(sum(len(part.keys) for part in parts), np.int64)
    variance, weights = np.empty(len(keys), np.float32), np.empty(len(keys), np.float32)
    for view, (part, first) in enumerate(zip(parts, starts, strict=True)):
        pixel = part.keys // rays
        place = np.arange(len(pixel)) + (begins - first[:-1])[pixel]
        keys[place] = part.keys + (pixel * (views - 1) + view) * rays
        variance[place], weights[place] = part.variance, part.weights
        begins = begins + np.diff(first)
    return Candidates(keys, variance, weights)


def split(found: Candidates, views: int, rays: int) -> list[Candidates]:
    """Return the footprints on each of a projector's views, of so many rays each."""
    if views == 1:
        return [found]
    of_view = (found.keys % (views * rays) // rays).astype(np.int16)
    parts = []
    for view in range(views):
        own = of_view == view
        keys = found.keys[own]
        keys -= (keys // (views * rays) * (views - 1) + view) * rays
        parts.append(Candidates(keys, found.variance[own], found.weights[own]))
    return parts


def is_symmetric(found: Candidates, rays: int) -> bool:
    """Tell whether footprints between the same rays of both sides differ by less than half.

    Where a rig isn't coaxial they have nothing in common.
    """
    ways = _both_ways(found, rays)
    apart = np.linalg.norm(ways.there - ways.back)
    return bool(apart < 0.5 * np.linalg.norm(ways.there))


def with_other_way(found: Candidates, rays: int) -> Candidates:
    """Return footprints with those candidates, too, that the other way found."""
    ways = _both_ways(found, rays)
    return Candidates(ways.keys, ways.variance, ways.there)


def averaged(found: Candidates, rays: int) -> Candidates:
    """Return the means of both ways."""
    ways = _both_ways(found, rays)
    mean: Float = ((ways.there + ways.back) / 2).astype(np.float32)
    return Candidates(ways.keys, ways.variance, mean)


def reconciled(series: tuple[Series, ...], found: Candidates, indirect: list[Float]) -> Candidates:
    """Find weights anew in what indirect light leaves, near those of the other way.

    The two may differ by a tenth of the weight and .003 of the floodlit image.
    """
    rays, views = len(series[0].lit), len(series)
    ways = _both_ways(found, rays * views)
    expected = split(Candidates(ways.keys, ways.variance, ways.back), views, rays)
    parts = []
    for each, other, light in zip(series, expected, indirect, strict=True):
        near = other.uncertain(each, 0.1, 0.003)
        parts.append(reweighted(each, near, light, near.weights))
    return joined(parts, rays)


def _both_ways(found: Candidates, rays: int) -> _Ways:
    from rfpipe.methods.adaptive.footprints.kernels import united

    back = found.keys % rays
    back *= rays
    back += found.keys // rays
    order = np.argsort(back)
    own, other = (found.keys, found.weights, found.variance), (found.weights, found.variance)
    return _Ways(*united(*own, back[order], *(each[order] for each in other)))
