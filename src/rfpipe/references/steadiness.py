"""Changes of gain, lamp and room light, from brackets of one pattern taken several times.

Counts above black of bracket k, exposure e (of t_e seconds) and pixel x, where w is the mean over
brackets:

    y[k, e, x] = g[k, e] w[e, x] + r[k] t_e

====== ========== ====== =========================================================================
symbol code       shape  meaning
====== ========== ====== =========================================================================
g      brightness (K, E) gain of camera and lamp, mean 1
r      room       (K,)   light of the room in counts a second, mean 0
====== ========== ====== =========================================================================

A lamp that warms up changes g slowly, and alike in all exposures; automatic gain changes it from
bracket to bracket; a lamp that flickers changes exposures independently, see `rfpipe.rigs.flicker`.
Size of gain and flicker is the standard deviation of g beside a smooth change with k.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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

Double = NDArray[np.float64]

_MOST_PIXELS, _MOST_SAMPLES = 20_000, 2_000_000  # that are read of a frame, and of all frames
_MOST_NOISE = 0.02  # of an exposure's light, relative, beyond which it is not judged
_MOST_ALIKE = 1e6  # condition number up to which projector's and room's light are separable
_DARKER = 0.8  # light of a longer exposure over a shorter one's, where frames are late
_MEDIAN = 0.6745  # of the absolute value of a normal variable of deviation 1
_SCATTERS = SIGNIFICANCE / 2  # of a standard deviation: about half of the range of few values


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


def camera_of(sensor: Sensor) -> CameraModel | None:
    """Return the camera of counts behind a sensor; None for exact radiance."""
    camera = sensor.sensor if isinstance(sensor, ResampledSensor) else sensor
    return camera if isinstance(camera, CameraModel) else None


def sample(frames: NDArray[Any], brackets: int = 1) -> Double:
    """Return some pixels of each frame of a bracket, (E, ...) to (E, n), fewer of many brackets."""
    most = min(_MOST_PIXELS, max(1, _MOST_SAMPLES // (len(frames) * brackets)))
    return np.asarray(thinned(frames, most), np.float64)


def faults_of_references(blacks: Double, whites: Double, camera: CameraModel) -> list[Fault]:
    """Find faults in sampled brackets of the all-off and the all-on pattern, (K, E, n) each."""
    late = _late(blacks, whites)
    if late is not None:
        return [late]
    samples = Samples(whites, blacks.mean(axis=0))
    unsteady, moved = scatter_of(samples, camera), motion_of(samples, camera)
    if moved is not None and (unsteady is None or unsteady.kind != "late"):
        return [moved]
    if unsteady is not None and unsteady.exceeds(CAPTURE):
        return [unsteady]
    found = [unsteady, _room_of_references(blacks, samples, camera)]
    return [fault for fault in found if fault is not None]


def scatter_of(samples: Samples, camera: CameraModel) -> Fault | None:
    """Find gain or a lamp that scatters from bracket to bracket; None where it is steady.

    Frames in the place of others make them scatter, too.
    """
    late = _out_of_order(samples.counts, camera)
    if late is not None:
        return late
    gains, noise = _brightness(samples, camera)
    judged = noise < _MOST_NOISE
    if len(gains) < 2 or not judged.any():
        return None
    logarithms = np.log(np.maximum(gains[:, judged], 1e-6))
    scatter, noise = np.array([_scatter(one) for one in logarithms.T]), noise[judged]
    is_noise = scatter < _SCATTERS * noise
    worst = float(np.where(is_noise, 0, np.sqrt(np.maximum(scatter**2 - noise**2, 0))).max())
    if worst < NOTED.light:
        return None
    return gain_or_flicker(worst, _flicker(samples, camera), camera.exposures)


def motion_of(samples: Samples, camera: CameraModel) -> Fault | None:
    """Find brackets that differ from the mean bracket in their shape; None where none does.

    They differ where something moved, or where a part of the picture lost its light: by more than
    g and r can explain, and by more than `CAPTURE` accepts.
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
        chance = SIGNIFICANCE * np.sqrt(2 * np.square(variance).sum())
        if square > chance:
            largest = max(largest, float(np.sqrt(square / np.square(mean).sum())))
    fault = moved_fault(largest)
    return fault if fault.exceeds(CAPTURE) else None


def _flicker(samples: Samples, camera: CameraModel) -> float | None:
    """Scatter of the ratios of exposures; see `rfpipe.rigs.flicker.flicker_of`."""
    known = samples.black, camera.exposures, SATURATION_FRACTION * camera.white_level
    ratios = np.array([exposure_ratios(bracket, *known) for bracket in samples.counts])
    return flicker_of(ratios[:, 0], ratios[:, 1], camera.exposures, _scatter, _SCATTERS)


def smooth_changes(gains: Double, times: Double | None = None) -> bool:
    """Test whether a lamp's brightness (K, C) drifts rather than jumps from value to value.

    `times` ascend; by default they are the values' numbers. Each value is compared with a straight
    line between its neighbours, and that with the steps from value to value.
    """
    if len(gains) < 5:
        return True
    times = np.arange(len(gains), dtype=np.float64) if times is None else times
    span = times[2:] - times[:-2]
    weight = ((times[1:-1] - times[:-2]) / np.where(span > 0, span, 1))[:, None]
    off = gains[1:-1] - (1 - weight) * gains[:-2] - weight * gains[2:]
    off /= np.sqrt(1 + weight**2 + (1 - weight) ** 2)
    jumps, steps = (
        np.median(np.abs(values), axis=0).max() / _MEDIAN
        for values in (off, np.diff(gains, axis=0) / np.sqrt(2))
    )
    return bool(jumps < NOTED.light or jumps < 0.5 * steps)


def _late(blacks: Double, whites: Double) -> Fault | None:
    """Find a first white picture that is the black picture before it."""
    if len(whites) > 2 and is_of_previous(whites[0], blacks.mean(axis=0), whites[1:].mean(axis=0)):
        return late_fault(1.0, "the first white picture is dark")
    return None


def _out_of_order(counts: Double, camera: CameraModel) -> Fault | None:
    """Find frames of the exposure before: longer ones are darker."""
    light = counts.mean(axis=(0, 2)) - camera.black_level_counts
    least = 0.01 * camera.white_level  # above the noise
    if is_out_of_order(light, _DARKER, least):
        return late_fault(1.0, "a longer exposure is darker")
    return None


def _brightness(samples: Samples, camera: CameraModel) -> tuple[Double, Double]:
    """Gain of each bracket and exposure, (K, E), and the noise of one exposure, (E,).

    It is the slope of a bracket's pixels over their means, which light of the room leaves as it is,
    or the ratio of sums where slopes of all exposures are too noisy. Pixels count that are never
    near saturation. The noise is infinite without light.
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
        over = np.where(norm > 0, norm, 1)
        gains.append((weights * light).sum(axis=2) / over)
        noise = np.sqrt((weights**2 * variance).sum(axis=1)) / over
        noises.append(np.where(norm > 0, noise, np.inf))
    way = 0 if (noises[0] < _MOST_NOISE).any() else 1
    return gains[way], noises[way]


def _scatter(values: Double) -> float:
    """Standard deviation of values (K,) beside a smooth change with k.

    Second differences of independent values have six times their variance; their median leaves a
    single jump out.
    """
    if len(values) < 5:
        return float(values.std(ddof=1))
    return float(np.median(np.abs(np.diff(values, n=2))) / (_MEDIAN * np.sqrt(6)))


def _room_of_references(blacks: Double, whites: Samples, camera: CameraModel) -> Fault | None:
    """Find light of the room that changes among black pictures, or among white ones."""
    seconds = camera.exposures
    white = float(np.maximum(whites.counts[:, 0] - whites.black[0], 0).mean()) / seconds[0]
    if white <= 0 or camera.response_gamma != 1:
        return None
    change, *_ = black_change(blacks, seconds, SATURATION_FRACTION * camera.white_level)
    room, deviation = _room(whites, camera)
    change_of_whites = float(np.ptp(room)) if len(room) else 0.0
    if change_of_whites > SIGNIFICANCE * np.sqrt(2) * deviation:
        change = max(change, change_of_whites)
    count = len(blacks) + len(whites.counts)
    fault = room_fault(change / white, f"in {count} black and white pictures")
    return fault if fault.exceeds(NOTED) else None


def _room(samples: Samples, camera: CameraModel) -> tuple[Double, float]:
    """Light of the room in counts a second, (K / 2,), in pairs of brackets, and its noise.

    Weighted least squares of ``y = g w + r t`` for g and r over all exposures and pixels.
    """
    light = samples.counts - samples.black
    mean = light.mean(axis=0)
    usable = (samples.counts < SATURATION_FRACTION * camera.white_level).all(axis=0)
    weights = np.where(usable, 1 / CountNoise.of(camera).variance(mean), 0).ravel()
    times = np.broadcast_to(np.asarray(camera.exposures)[:, None], mean.shape)
    terms = np.stack([mean.ravel(), times.ravel()])
    normal = (terms * weights) @ terms.T
    scale = np.sqrt(normal.diagonal())
    if not scale.all() or np.linalg.cond(normal / np.outer(scale, scale)) > _MOST_ALIKE:
        return np.zeros(0), 0.0
    inverse = np.linalg.inv(normal)
    pairs = light[: len(light) // 2 * 2].reshape(-1, 2, light[0].size).mean(axis=1)
    room = (pairs * weights) @ terms.T @ inverse[:, -1]
    return room, float(np.sqrt(inverse[-1, -1] / 2))
