"""Faults of gain, lamp and room light, from the brackets of one repeated pattern.

Counts above black of bracket k, exposure e (of t_e seconds) and pixel x, where w is the mean over
the brackets:

    y[k, e, x] = g[k, e] w[e, x] + r[k] t_e

====== ===== ====== ===============================================================================
symbol code  shape  meaning
====== ===== ====== ===============================================================================
g      gains (K, E) gain of camera and lamp, 1 on average
r      room  (K,)   light of the room in counts per second, 0 on average
====== ===== ====== ===============================================================================

A lamp that warms up changes g slowly and equally in all exposures; automatic gain changes it from
bracket to bracket; a lamp that flickers changes exposures independently, see `rfpipe.rigs.flicker`.
The size of a fault of gain or flicker is the standard deviation of g around a smooth change with k.
`rfpipe.references.comparison` says why check pictures are compared in another way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.photometry.camera import CameraModel
from rfpipe.photometry.resampling import ResampledSensor
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.check_pictures import thinned
from rfpipe.rigs.diagnosis import black_change
from rfpipe.rigs.faults import (
    CAPTURE,
    NOTED,
    SIGNIFICANCE,
    Fault,
    late_fault,
    moved_fault,
    room_fault,
)
from rfpipe.rigs.flicker import exposure_ratios, flicker_of, gain_or_flicker
from rfpipe.rigs.late import is_of_previous, is_out_of_order
from rfpipe.rigs.noise import CountNoise
from rfpipe.units import SATURATION_FRACTION

_MAX_PIXELS, _MAX_SAMPLES = 20_000, 2_000_000
"""Samples read from a frame, and from all frames together."""

_MAX_NOISE = 0.02
"""Relative noise of an exposure's light beyond which the exposure is not judged."""

_MAX_CONDITION = 1e6
"""Condition number up to which the projector's and the room's light are separable."""

_DARKER = 0.8
"""Light of a longer exposure over a shorter one's below which frames are out of order."""

_MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a normal variable of standard deviation 1."""

_SCATTER_SIGNIFICANCE = SIGNIFICANCE / 2
"""The same for a standard deviation, which is about half the range of few values."""


class Samples(NamedTuple):
    """Counts of some pixels of brackets of one pattern.

    Attributes
    ----------
    counts : ndarray of float64, shape (K, E, n)
    black : ndarray of float64, shape (E, n)
        Mean counts without the projector's light.
    """

    counts: Double
    black: Double


def camera_model_of(sensor: Sensor) -> CameraModel | None:
    """Return the camera whose counts a sensor resamples or returns; None for exact radiance."""
    camera = sensor.sensor if isinstance(sensor, ResampledSensor) else sensor
    return camera if isinstance(camera, CameraModel) else None


def sample_pixels(bracket: NDArray[Any], brackets: int = 1) -> Double:
    """Return some pixels of a bracket, (E, ...) to (E, n), fewer where there are many brackets."""
    limit = min(_MAX_PIXELS, max(1, _MAX_SAMPLES // (len(bracket) * brackets)))
    return np.asarray(thinned(bracket, limit), np.float64)


def faults_of_reference_brackets(
    all_off: Double, all_on: Double, camera: CameraModel
) -> list[Fault]:
    """Return the faults in sampled all-off and all-on brackets, (K, E, n) each."""
    late = _late_fault(all_off, all_on)
    if late is not None:
        return [late]
    samples = Samples(all_on, all_off.mean(axis=0))
    unsteady, moved = unsteadiness_of(samples, camera), motion_of(samples, camera)
    if moved is not None and (unsteady is None or unsteady.kind != "late"):
        return [moved]
    if unsteady is not None and unsteady.exceeds(CAPTURE):
        return [unsteady]
    faults = [unsteady, _room_fault_of_references(all_off, samples, camera)]
    return [fault for fault in faults if fault is not None]


def unsteadiness_of(samples: Samples, camera: CameraModel) -> Fault | None:
    """Return the fault of gain or lamp that changes from bracket to bracket; None for none.

    Frames that are out of order are found first, since they change the gain, too.
    """
    late = _out_of_order_fault(samples.counts, camera)
    if late is not None:
        return late
    gains, noise = _gains(samples, camera)
    judged = noise < _MAX_NOISE
    if len(gains) < 2 or not judged.any():
        return None
    logarithms = np.log(np.maximum(gains[:, judged], 1e-6))
    scatter, noise = np.array([_scatter(values) for values in logarithms.T]), noise[judged]
    is_noise = scatter < _SCATTER_SIGNIFICANCE * noise
    excess = np.sqrt(np.maximum(scatter**2 - noise**2, 0))
    largest = float(np.where(is_noise, 0, excess).max())
    if largest < NOTED.light:
        return None
    return gain_or_flicker(largest, _flicker(samples, camera), camera.exposures)


def motion_of(samples: Samples, camera: CameraModel) -> Fault | None:
    """Return the fault of brackets whose shape differs from the mean bracket; None for none.

    The shape differs where something moved, or where a part of the picture lost its light: by more
    than g and r explain, and by more than `CAPTURE` accepts.
    """
    if camera.response_gamma != 1:
        return None
    light = samples.counts - samples.black
    variances = CountNoise.of(camera).variance(light.mean(axis=0))
    is_below = samples.counts < SATURATION_FRACTION * camera.white_level
    usable = np.asarray(is_below.all(axis=0))
    largest = 0.0
    for exposure, pixels in enumerate(usable):
        if pixels.mean() < 0.5:
            continue
        brackets, variance = light[:, exposure, pixels], variances[exposure, pixels]
        mean = brackets.mean(axis=0)
        terms = np.stack([mean, np.ones_like(mean)], axis=1)
        residuals = brackets - brackets @ np.linalg.pinv(terms).T @ terms.T
        square = float(np.square(residuals).sum(axis=1).max() - variance.sum())
        fluctuation = SIGNIFICANCE * np.sqrt(2 * np.square(variance).sum())
        if square > fluctuation:
            largest = max(largest, float(np.sqrt(square / np.square(mean).sum())))
    fault = moved_fault(largest)
    return fault if fault.exceeds(CAPTURE) else None


def is_smooth(gains: Double, times: Double | None = None) -> bool:
    """Test whether a lamp's brightness drifts rather than jumps from value to value.

    Each value is compared with the straight line between its neighbours, and that difference with
    the steps from value to value.

    Parameters
    ----------
    gains : ndarray of float64, shape (K, C)
    times : ndarray of float64, shape (K,), optional
        Ascending; by default 0, 1, 2, ...
    """
    if len(gains) < 5:
        return True
    times = np.arange(len(gains), dtype=np.float64) if times is None else times
    span = times[2:] - times[:-2]
    weight = ((times[1:-1] - times[:-2]) / np.where(span > 0, span, 1))[:, None]
    bends = gains[1:-1] - (1 - weight) * gains[:-2] - weight * gains[2:]
    bends /= np.sqrt(1 + weight**2 + (1 - weight) ** 2)
    jump, step = (
        np.median(np.abs(values), axis=0).max() / _MEDIAN_OF_NORMAL
        for values in (bends, np.diff(gains, axis=0) / np.sqrt(2))
    )
    return bool(jump < NOTED.light or jump < 0.5 * step)


def _flicker(samples: Samples, camera: CameraModel) -> float | None:
    """Scatter of the ratios of exposures; see `rfpipe.rigs.flicker.flicker_of`."""
    known = samples.black, camera.exposures, SATURATION_FRACTION * camera.white_level
    ratios = np.array([exposure_ratios(bracket, *known) for bracket in samples.counts])
    return flicker_of(ratios[:, 0], ratios[:, 1], camera.exposures, _scatter, _SCATTER_SIGNIFICANCE)


def _late_fault(all_off: Double, all_on: Double) -> Fault | None:
    """Return the fault of a first all-on picture that shows the all-off pattern before it."""
    if len(all_on) > 2 and is_of_previous(all_on[0], all_off.mean(axis=0), all_on[1:].mean(axis=0)):
        return late_fault(1.0, "the first all-on picture is dark")
    return None


def _out_of_order_fault(counts: Double, camera: CameraModel) -> Fault | None:
    """Return the fault of frames that belong to the previous exposure: longer ones are darker."""
    light = counts.mean(axis=(0, 2)) - camera.black_level_counts
    threshold = 0.01 * camera.white_level  # above the noise
    if is_out_of_order(light, _DARKER, threshold):
        return late_fault(1.0, "a longer exposure is darker")
    return None


def _gains(samples: Samples, camera: CameraModel) -> tuple[Double, Double]:
    """Estimate the gain of each bracket and exposure, (K, E), and its noise, (E,).

    The gain is the slope of a bracket's pixels over their means, which doesn't depend on the room's
    light, or the ratio of sums where the slopes of all exposures are too noisy. Only pixels that
    are never near saturation count. The noise is infinite without light.
    """
    usable = (samples.counts < SATURATION_FRACTION * camera.white_level).all(axis=0)
    light = np.where(usable, samples.counts - samples.black, 0)
    mean = light.mean(axis=0)
    count = np.maximum(usable.sum(axis=1, keepdims=True), 1)
    centred = np.where(usable, mean - mean.sum(axis=1, keepdims=True) / count, 0)
    variance = np.where(usable, CountNoise.of(camera).variance(mean), 0)
    gains, noises = [], []
    for weights in (centred, usable.astype(np.float64)):
        norm = (weights * mean).sum(axis=1)
        divisor = np.where(norm > 0, norm, 1)
        gains.append((weights * light).sum(axis=2) / divisor)
        noise = np.sqrt((weights**2 * variance).sum(axis=1)) / divisor
        noises.append(np.where(norm > 0, noise, np.inf))
    estimator = 0 if (noises[0] < _MAX_NOISE).any() else 1
    return gains[estimator], noises[estimator]


def _scatter(values: Double) -> float:
    """Standard deviation of values (K,) around a smooth change with k.

    Second differences of independent values have six times their variance; their median is robust
    against a single jump.
    """
    if len(values) < 5:
        return float(values.std(ddof=1))
    return float(np.median(np.abs(np.diff(values, n=2))) / (_MEDIAN_OF_NORMAL * np.sqrt(6)))


def _room_fault_of_references(
    all_off: Double, all_on: Samples, camera: CameraModel
) -> Fault | None:
    """Return the fault of room light that changes among all-off or among all-on brackets."""
    seconds = camera.exposures
    light = float(np.maximum(all_on.counts[:, 0] - all_on.black[0], 0).mean()) / seconds[0]
    if light <= 0 or camera.response_gamma != 1:
        return None
    change, *_ = black_change(all_off, seconds, SATURATION_FRACTION * camera.white_level)
    room, deviation = _room_light(all_on, camera)
    change_of_all_on = float(np.ptp(room)) if len(room) else 0.0
    if change_of_all_on > SIGNIFICANCE * np.sqrt(2) * deviation:
        change = max(change, change_of_all_on)
    count = len(all_off) + len(all_on.counts)
    fault = room_fault(change / light, f"in {count} all-off and all-on pictures")
    return fault if fault.exceeds(NOTED) else None


def _room_light(samples: Samples, camera: CameraModel) -> tuple[Double, float]:
    """Estimate the room's light in counts per second for pairs of brackets, (K / 2,).

    Weighted least squares of ``y = g w + r t`` for g and r over all exposures and pixels. Returns
    the standard deviation of r, too; no values where g and r aren't separable.
    """
    light = samples.counts - samples.black
    mean = light.mean(axis=0)
    usable = (samples.counts < SATURATION_FRACTION * camera.white_level).all(axis=0)
    weights = np.where(usable, 1 / CountNoise.of(camera).variance(mean), 0).ravel()
    times = np.broadcast_to(np.asarray(camera.exposures)[:, None], mean.shape)
    terms = np.stack([mean.ravel(), times.ravel()])
    normal = (terms * weights) @ terms.T
    scale = np.sqrt(normal.diagonal())
    if not scale.all() or np.linalg.cond(normal / np.outer(scale, scale)) > _MAX_CONDITION:
        return np.zeros(0), 0.0
    inverse = np.linalg.inv(normal)
    pairs = light[: len(light) // 2 * 2].reshape(-1, 2, light[0].size).mean(axis=1)
    room = (pairs * weights) @ terms.T @ inverse[:, -1]
    return room, float(np.sqrt(inverse[-1, -1] / 2))
