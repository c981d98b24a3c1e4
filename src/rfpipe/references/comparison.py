"""Comparison of two pictures of one pattern: brightness, room light, and what differs beyond.

A look y at a pattern is compared with the first look w, over C channels:

    y = g w + a + b f + d

====== ======= ======= =========================================================================
symbol code    shape   meaning
====== ======= ======= =========================================================================
w      known   (N, C)  the first look, over N rays
y      later   (N, C)  another look
f      white   (N, C)  the floodlit picture
g      gain    (C,)    brightness of the lamp
a, b   room    (C,)    light of the room: even, or as the scene reflects it
d      rest    ()      norm of the residual beyond noise, over w's: 1 for half a pixel
====== ======= ======= =========================================================================
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.sensor import Merged
from rfpipe.references.reference_images import Merger
from rfpipe.rigs.faults import SIGNIFICANCE

Double = NDArray[np.float64]

# What the noise itself is known to, as a share of its square.
_NOISE_KNOWN = 0.1
# Rays from which on room light and brightness are separable.
_FEWEST = 16
# Share of a change's norm that room light must explain at least: it explains a part of any other.
_EXPLAINED = 0.7


class Change(NamedTuple):
    """Difference of a bracket from a picture of the same pattern.

    Attributes
    ----------
    gain, deviation : ndarray of float64, shape (C,)
        Its light relative to the picture's, and the standard deviation.
    rest : float
        What differs beyond brightness, room light and noise, relative to the picture's norm; 0
        where nothing.
    room : float
        Change of the room's light relative to the floodlit picture's; 0 unless it is significant.
    """

    gain: Double
    deviation: Double
    rest: float
    room: float = 0.0


def change(merger: Merger, known: Merged, bracket: NDArray[Any]) -> Change:
    """Compare a bracket (1, E, ...) with a merged picture (1, *camera_shape, C).

    The light of the room, a and b, is 0 unless it explains the residual of g alone.
    """
    later = merger.merge(bracket, 0)
    both = np.isfinite(known.variance[0]) & np.isfinite(later.variance[0])
    floodlit = merger.floodlit[None]
    was, now, v_was, v_now, white = (
        np.where(both, image[0], 0).reshape(-1, image.shape[-1]).astype(np.float64)
        for image in (known.radiance, later.radiance, known.variance, later.variance, floodlit)
    )
    total = was.sum(axis=0)
    over = np.where(total > 0, total, 1)
    gain = np.where(total > 0, now.sum(axis=0) / over, 1)
    noise = v_now + gain**2 * v_was
    deviation = np.sqrt(noise.sum(axis=0)) / over
    light = float((np.square(gain * was) - gain**2 * v_was).sum())
    rest = _beyond_noise(now - gain * was, noise, light)
    if rest == 0 or len(was) < _FEWEST:
        return Change(gain, deviation, rest)
    seen = both.reshape(-1, both.shape[-1]).all(axis=1)
    fitted, room, room_deviation, left = _with_room(*(it[seen] for it in (was, now, white, noise)))
    rest_of_fit = _beyond_noise(left, noise[seen], light)
    is_room = abs(room) > SIGNIFICANCE * room_deviation
    if is_room and rest_of_fit < (1 - _EXPLAINED) * rest:
        return Change(fitted, deviation, rest_of_fit, room)
    return Change(gain, deviation, rest)


def _beyond_noise(difference: Double, noise: Double, light: float) -> float:
    """Norm of a difference without its noise, relative to `light`; 0 for nothing but noise."""
    square = float(np.square(difference).sum() - noise.sum())
    chance = SIGNIFICANCE * np.sqrt(2 * np.square(noise).sum()) + _NOISE_KNOWN * noise.sum()
    return float(np.sqrt(square / light)) if light > 0 and square > chance else 0.0


def _with_room(
    was: Double, now: Double, white: Double, noise: Double
) -> tuple[Double, float, float, Double]:
    """Fit brightness and room light to images (N, C); see `change`.

    Returns
    -------
    gain : ndarray of float64, shape (C,)
    room, deviation : float
        Light of the room relative to `white`, and its standard deviation.
    residual : ndarray of float64, shape (N, C)
    """
    gain, residual = np.ones(was.shape[1]), now - was
    total, variance = 0.0, 0.0
    for channel in range(was.shape[1]):
        terms = np.stack([was[:, channel], np.ones(len(was)), white[:, channel]], axis=1)
        inverse = np.linalg.pinv(terms.T @ terms, rcond=1e-6, hermitian=True)
        solution = inverse @ terms.T @ now[:, channel]
        residual[:, channel] = now[:, channel] - terms @ solution
        gain[channel] = solution[0]
        mean = np.array([0, len(was), white[:, channel].sum()])
        spread = mean @ inverse @ (terms.T * noise[:, channel])
        total += float(mean @ solution)
        variance += float(spread @ terms @ inverse @ mean)
    over = float(white.sum()) or 1.0
    return gain, total / over, float(np.sqrt(max(variance, 0.0))) / over, residual
