"""Comparison of two pictures of one pattern: gain, room light, and residual.

A check picture y is compared with the first check picture w:

    y = g w + a + b f + d

====== ========= ======= =======================================================================
symbol code      shape   meaning
====== ========= ======= =======================================================================
w      earlier   (N, C)  the first check picture, radiance of N rays and C channels
y      later     (N, C)  the check picture, radiance
f      f         (N, C)  the floodlit image
g      gain      (C,)    brightness of the lamp, relative to the first check picture
a, b   room      (C,)    change of the room's light: uniform, and as the scene reflects it
d      residual  ()      norm of the residual beyond noise, relative to w's; a shift by half a
                         pixel gives about 1
====== ========= ======= =======================================================================

`rfpipe.references.steadiness` estimates gain and room light from reference brackets instead. Those
are taken before black level and defects are known, and flicker shows only in single exposures, so
it works on counts of each exposure; check pictures are merged to radiance first, which also shows
motion at every ray.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.photometry.sensor import MergedImages
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.rigs.faults import SIGNIFICANCE

_NOISE_UNCERTAINTY = 0.1
"""Relative uncertainty of the predicted squared noise."""

_MIN_RAYS = 16
"""Number of rays from which room light and gain are separable."""

_MIN_EXPLAINED = 0.7
"""Share of the residual that room light must explain; it explains a part of any change."""


class Difference(NamedTuple):
    """Difference between two pictures of one pattern.

    Attributes
    ----------
    gain, deviation : ndarray of float64, shape (C,)
        Light of the later picture over the earlier one's, and its standard deviation.
    residual : float
        Norm of the difference beyond gain, room light and noise, relative to the earlier picture's
        norm; 0 where the difference is not significant.
    room : float
        Change of the room's light relative to the floodlit image; 0 unless it is significant.
    """

    gain: Double
    deviation: Double
    residual: float
    room: float = 0.0


class _Fit(NamedTuple):
    """Least-squares fit of gain and room light.

    Attributes
    ----------
    gain : ndarray of float64, shape (C,)
    room, room_deviation : float
        Light of the room relative to the floodlit image, and its standard deviation.
    residual : ndarray of float64, shape (N, C)
    """

    gain: Double
    room: float
    room_deviation: float
    residual: Double


def compare_pictures(
    references: ReferenceImages, earlier: MergedImages, bracket: NDArray[Any]
) -> Difference:
    """Compare a bracket with an earlier picture of its pattern.

    Parameters
    ----------
    references : ReferenceImages
    earlier : MergedImages
        One picture, (1, *camera_shape, C).
    bracket : ndarray, shape (1, E, ...)

    Returns
    -------
    Difference
        The room's light, a and b, is 0 unless it explains the residual of the gain alone.
    """
    later = references.merge(bracket)
    is_known = np.isfinite(earlier.variance[0]) & np.isfinite(later.variance[0])
    images = (earlier.radiance, later.radiance, earlier.variance, later.variance)
    w, y, w_variance, y_variance, f = (
        np.where(is_known, image[0], 0).reshape(-1, image.shape[-1]).astype(np.float64)
        for image in (*images, references.floodlit[None])
    )
    total = w.sum(axis=0)
    divisor = np.where(total > 0, total, 1)
    gain = np.where(total > 0, y.sum(axis=0) / divisor, 1)
    noise = y_variance + gain**2 * w_variance
    deviation = np.sqrt(noise.sum(axis=0)) / divisor
    energy = float((np.square(gain * w) - gain**2 * w_variance).sum())
    residual = _norm_beyond_noise(y - gain * w, noise, energy)
    if residual == 0 or len(w) < _MIN_RAYS:
        return Difference(gain, deviation, residual)
    rays = is_known.reshape(-1, is_known.shape[-1]).all(axis=1)
    fit = _fit_room_light(w[rays], y[rays], f[rays], noise[rays])
    fit_residual = _norm_beyond_noise(fit.residual, noise[rays], energy)
    is_room = abs(fit.room) > SIGNIFICANCE * fit.room_deviation
    if is_room and fit_residual < (1 - _MIN_EXPLAINED) * residual:
        return Difference(fit.gain, deviation, fit_residual, fit.room)
    return Difference(gain, deviation, residual)


def _norm_beyond_noise(difference: Double, noise: Double, energy: float) -> float:
    """Norm of a difference, its noise subtracted, relative to ``sqrt(energy)``.

    Parameters
    ----------
    difference, noise : ndarray of float64, shape (N, C)
        The noise is a variance.
    energy : float
        Squared norm of the picture.

    Returns
    -------
    float
        0 where the difference may be noise.
    """
    square = float(np.square(difference).sum() - noise.sum())
    fluctuation = SIGNIFICANCE * np.sqrt(2 * np.square(noise).sum())
    threshold = fluctuation + _NOISE_UNCERTAINTY * noise.sum()
    return float(np.sqrt(square / energy)) if energy > 0 and square > threshold else 0.0


def _fit_room_light(w: Double, y: Double, f: Double, noise: Double) -> _Fit:
    """Fit ``y = g w + a + b f`` to images (N, C) by least squares, channel by channel.

    `noise` is the variance of y, used for the standard deviation of the room's light only.
    """
    gain, residual = np.ones(w.shape[1]), y - w
    room_sum, room_variance = 0.0, 0.0
    for channel in range(w.shape[1]):
        terms = np.stack([w[:, channel], np.ones(len(w)), f[:, channel]], axis=1)
        inverse = np.linalg.pinv(terms.T @ terms, rcond=1e-6, hermitian=True)
        solution = inverse @ terms.T @ y[:, channel]
        residual[:, channel] = y[:, channel] - terms @ solution
        gain[channel] = solution[0]
        room_weights = np.array([0, len(w), f[:, channel].sum()])
        spread = room_weights @ inverse @ (terms.T * noise[:, channel])
        room_sum += float(room_weights @ solution)
        room_variance += float(spread @ terms @ inverse @ room_weights)
    total = float(f.sum()) or 1.0
    room_deviation = float(np.sqrt(max(room_variance, 0.0))) / total
    return _Fit(gain, room_sum / total, room_deviation, residual)
