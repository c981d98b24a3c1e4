"""Footprints between the views of a light field: what each way says of the other.

Where cameras and projectors share their rays, the light from ray j to ray i is that from i to j,
and the two are measured in different pictures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.methods.footprints.candidates import Footprints, reweighted
from rfpipe.methods.footprints.kernels import united
from rfpipe.methods.footprints.series import Series
from rfpipe.methods.footprints.typed import Float, Int64

__all__ = ["averaged", "is_symmetric", "joined", "reconciled", "split", "with_other_way"]

# Footprints that differ from those of the other way by less than this part of them are the same:
# where a rig isn't coaxial they have nothing in common.
_SAME = 0.5
# How much two ways may differ, as parts of the weight and of the floodlit image.
_APART, _APART_OF_ALL = 0.1, 0.003


@dataclass(frozen=True)
class _Ways:
    """Candidates of either way, in order of their keys, and the weights both ways."""

    keys: Int64
    there: Float
    back: Float
    variance: Float


def joined(parts: list[Footprints], rays: int) -> Footprints:
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
    return Footprints(keys, variance, weights)


def split(found: Footprints, views: int, rays: int) -> list[Footprints]:
    """Return the footprints on each of a projector's views, of so many rays each."""
    if views == 1:
        return [found]
    of_view = (found.keys % (views * rays) // rays).astype(np.int16)
    parts = []
    for view in range(views):
        own = of_view == view
        keys = found.keys[own]
        keys -= (keys // (views * rays) * (views - 1) + view) * rays
        parts.append(Footprints(keys, found.variance[own], found.weights[own]))
    return parts


def is_symmetric(found: Footprints, rays: int) -> bool:
    """Tell whether footprints between the same rays of both sides are alike both ways."""
    ways = _both_ways(found, rays)
    apart = np.linalg.norm(ways.there - ways.back)
    return bool(apart < _SAME * np.linalg.norm(ways.there))


def with_other_way(found: Footprints, rays: int) -> Footprints:
    """Return footprints with those candidates, too, that the other way found."""
    ways = _both_ways(found, rays)
    return Footprints(ways.keys, ways.variance, ways.there)


def averaged(found: Footprints, rays: int) -> Footprints:
    """Return the means of both ways."""
    ways = _both_ways(found, rays)
    mean: Float = ((ways.there + ways.back) / 2).astype(np.float32)
    return Footprints(ways.keys, ways.variance, mean)


def reconciled(series: tuple[Series, ...], found: Footprints, indirect: list[Float]) -> Footprints:
    """Find weights anew in what indirect light leaves, near those of the other way."""
    rays, views = len(series[0].lit), len(series)
    ways = _both_ways(found, rays * views)
    expected = split(Footprints(ways.keys, ways.variance, ways.back), views, rays)
    parts = []
    for each, other, light in zip(series, expected, indirect, strict=True):
        near = other.uncertain(each, _APART, _APART_OF_ALL)
        parts.append(reweighted(each, near, light, near.weights))
    return joined(parts, rays)


def _both_ways(found: Footprints, rays: int) -> _Ways:
    back = found.keys % rays
    back *= rays
    back += found.keys // rays
    order = np.argsort(back)
    own, other = (found.keys, found.weights, found.variance), (found.weights, found.variance)
    return _Ways(*united(*own, back[order], *(each[order] for each in other)))
