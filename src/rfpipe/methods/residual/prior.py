"""How strongly places of the image may exchange light: variances, learned from the pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.transport.wavelet.haar import Group, Haar

__all__ = ["first_guess", "learned"]

# The variance of what places exchange falls with the square of their distance, in units of so many
# cells.
_REACH = 0.5
_BINS_PER_OCTAVE = 2
_LEAST = 1e-10  # of the largest variance


def first_guess(haar: Haar, total: float) -> Float:
    """Return variances before any fit, (size, size): smooth, and falling with the distance.

    Parameters
    ----------
    haar : Haar
    total : float
        Their sum.
    """
    variance = np.empty((haar.size, haar.size), np.float32)
    for one, other in _pairs(haar):
        apart = 1 + np.square(_distances(one, other) / _REACH)
        each = (one.side * other.side) ** 2 / apart
        _spread(variance, one, other, each.astype(np.float32))
    variance *= np.float32(total / variance.sum(dtype=np.float64))
    return variance


def learned(haar: Haar, energy: Float) -> Float:
    """Return variances from the expected squares of single coefficients, (size, size).

    Those of a pair of places are averaged over orientations and with their neighbours', and drawn
    towards the mean of all pairs of the same two scales at about the same distance.
    """
    from scipy.ndimage import uniform_filter

    variance = np.empty_like(energy)
    for one, other in _pairs(haar):
        part = energy[one.rows, other.rows].reshape(
            one.orientations, one.places, other.orientations, other.places
        )
        pairs = part.mean(axis=(0, 2))
        grid = (*one.grid, *other.grid)
        smooth = uniform_filter(pairs.reshape(grid), size=(1, 3, 3, 1, 3, 3), mode="nearest")
        pairs = (pairs + smooth.reshape(pairs.shape)) / 2
        key = _bins(_distances(one, other))
        typical = np.bincount(key.ravel(), pairs.ravel()) / np.maximum(np.bincount(key.ravel()), 1)
        count = one.orientations * other.orientations
        drawn = (count * pairs + typical[key]) / (count + 1)
        _spread(variance, one, other, drawn.astype(np.float32))
    floor: Float = np.maximum(variance, np.float32(_LEAST) * variance.max())
    return floor


def _pairs(haar: Haar) -> Iterator[tuple[Group, Group]]:
    """Yield each pair of scales once."""
    for index, one in enumerate(haar.groups):
        for other in haar.groups[index:]:
            yield one, other


def _spread(variance: Float, one: Group, other: Group, each: Float) -> None:
    """Write the variances of pairs of places for all orientations, both ways."""
    if one is other:
        each = np.float32(0.5) * (each + each.T)
    shape = (one.orientations, one.places, other.orientations, other.places)
    whole = np.broadcast_to(each[None, :, None], shape).reshape(
        one.orientations * one.places, other.orientations * other.places
    )
    variance[one.rows, other.rows] = whole
    if one is not other:
        variance[other.rows, one.rows] = whole.T


def _distances(one: Group, other: Group) -> Float:
    """Distances of places in cells, whichever views they are in, (places, places)."""
    apart = one.centres()[:, None] - other.centres()
    distance: Float = np.hypot(apart[..., 0], apart[..., 1])
    return distance


def _bins(distance: Float) -> NDArray[np.int64]:
    bins: NDArray[np.int64] = (_BINS_PER_OCTAVE * np.log2(1 + distance)).astype(np.int64)
    return bins
