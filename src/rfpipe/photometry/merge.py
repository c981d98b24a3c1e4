"""The maximum-likelihood merge of brackets of counts, with its variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.photometry.demosaic import demosaic
from rfpipe.photometry.sensor import Merged, MergeOptions, check_black, check_frames, check_shape
from rfpipe.units import COUNTS, RADIANCE

Float = NDArray[np.float32]

UNKNOWN_DEVIATION = 0.125
"""Standard deviation of a sample saturated in every exposure, in units of the full scale. That
it is light is known, how much is not: the value is significant, eight deviations among any number
of measurements, and its weight small."""

_ROUNDS = 2
# Rounds of weights from the pooled estimate; a third changes the result by less than a thousandth
# of its standard deviation (RMS), a hundredth at most.

_GLOW_SIGNIFICANCE = 4.0
# Electrons in the all-off frames count as more than the dark current above this many standard
# deviations of their noise; its shot noise then enters the variance.

_SAMPLES = 2**14  # merged at once: what comes between stays in the cache


@dataclass(frozen=True)
class CameraNumbers:
    """What makes a camera's counts; see `rfpipe.photometry.CameraModel`, which explains it."""

    exposures: tuple[float, ...] = (1 / 64, 1 / 16, 1 / 4, 1.0)
    electrons_per_radiance: float = 640_000.0
    full_well_electrons: float = 20_000.0
    read_noise_electrons: float = 5.0
    dark_current_electrons: float = 1.0
    black_level_counts: int = 64
    bits: int = 12
    psf_sigma: float = 0.0
    vignetting: float = 0.0
    flare: float = 0.0
    bayer: str | None = None
    response_gamma: float = 1.0
    white_level_counts: int | None = None

    def __post_init__(self) -> None:
        from pydantic import ValidationError

        from rfpipe.config.base import explained
        from rfpipe.config.camera import CameraConfig

        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        try:
            CameraConfig.model_validate(settings)
        except ValidationError as error:
            raise InputError(f"camera: {explained(error)[0]}") from None

    @property
    def white_level(self) -> int:
        """Full scale in counts: where the sensor saturates, if that is below what its bits hold."""
        return int(2**self.bits) - 1 if self.white_level_counts is None else self.white_level_counts

    @property
    def electrons_per_count(self) -> float:
        """Gain of a linear camera: the full well gives full scale."""
        return self.full_well_electrons / (self.white_level - self.black_level_counts)


class CountsMerge:
    """The merge of a camera's brackets; see `CameraModel.merging`.

    Threads may share it.

    Parameters
    ----------
    camera : CameraNumbers
    black : ndarray of float32, shape (E, ...)
        Mean of the all-off frames in counts.
    options : MergeOptions
    """

    def __init__(self, camera: CameraNumbers, black: NDArray[Any], options: MergeOptions) -> None:
        black = np.asarray(black, np.float32)
        check_black(black, len(camera.exposures))
        self._camera = camera
        self._shape = black.shape
        self._collection = [
            camera.electrons_per_radiance * exposure for exposure in camera.exposures
        ]
        self._full_scale = camera.full_well_electrons / self._collection[0]
        self._usable_below = COUNTS(np.ceil(options.saturation_fraction * camera.white_level))
        table = electrons_of_counts(camera, options)
        background = np.interp(black, np.arange(len(table)), table).astype(np.float32)
        # the converter's steps are as coarse in electrons as the response is steep
        steps = np.square(np.gradient(table)).astype(np.float32) / 12
        noise = _fixed_noise(camera, background, options)
        self._is_linear = camera.response_gamma == 1 and options.response is None
        self._table, self._steps = table, steps
        self._background = (black if self._is_linear else background).reshape(len(black), -1)
        self._noise = (noise + steps[0] if self._is_linear else noise).reshape(len(black), -1)

    def __call__(self, frames: NDArray[Any], first_index: int = 0) -> Merged:
        """Merge brackets ``(B, *frame_shape)``, the first of them that of pattern `first_index`.

        Raises
        ------
        CaptureError
            When frames have the wrong shape, dtype or range; names the pattern.
        """
        frames = np.asarray(frames)
        check_shape(frames, self._shape, first_index)
        check_frames(frames, self._camera.white_level, first_index)
        count, exposures, *image = frames.shape
        flat = frames.reshape(count, exposures, prod(image))
        radiance, variance = np.empty((2, count, flat.shape[-1]), RADIANCE)
        saturated = 0
        for index, bracket in enumerate(flat):
            for first in range(0, flat.shape[-1], _SAMPLES):
                some = slice(first, first + _SAMPLES)
                counts, noise = bracket[:, some], self._noise[:, some]
                if self._is_linear:
                    electrons = counts - self._background[:, some]
                    electrons *= np.float32(self._camera.electrons_per_count)
                else:
                    electrons = self._table[counts] - self._background[:, some]
                    noise = noise + self._steps[counts]
                usable = counts < self._usable_below
                result = merge_bracket(
                    electrons, usable, self._collection, list(noise), self._full_scale
                )
                radiance[index, some], variance[index, some], lost = result
                saturated += lost
        merged = radiance.reshape(count, *image), variance.reshape(count, *image)
        if self._camera.bayer is not None:
            merged = demosaic(*merged, self._camera.bayer)
        return Merged(*merged, saturated)


def merge_bracket(
    electrons: Float,
    usable: NDArray[np.bool_],
    collection: Sequence[float],
    noise: Sequence[Float],
    full_scale: float,
) -> tuple[Float, Float, int]:
    """Merge a bracket into the most likely radiance of each sample.

    Parameters
    ----------
    electrons : ndarray of float32, shape (E, ...)
        Signal of each exposure in electrons, the all-off frame subtracted, response linear.
    usable : ndarray of bool, shape (E, ...)
        False where the raw count was saturated.
    collection : sequence of float, length E
        Electrons that a radiance of 1 gives in each exposure, above 0, ascending.
    noise : sequence of E ndarrays of float32, shape (...) or ()
        Variance in electrons squared of all but the signal's own shot noise, above 0.
    full_scale : float
        Radiance that saturates the shortest exposure, above 0.

    Returns
    -------
    radiance, variance : ndarray of float32, shape (...)
        Finite everywhere.
    saturated : int
        Samples saturated in every exposure: they get the shortest exposure's (clipped) value and
        a standard deviation of `UNKNOWN_DEVIATION`.

    Notes
    -----
    With electrons ``e_i = k_i L + noise`` of variance ``k_i L + n_i``, the estimate is
    ``L = sum(w_i e_i) / sum(w_i k_i)``, ``w_i = k_i / (k_i L + n_i)``, of variance
    ``1 / sum(w_i k_i)``. The ``L`` in the weights is the pooled estimate, never the exposure's
    own noisy count: there, a count that came out low by chance would seem the less noisy and get
    more weight, which biases dark samples towards zero. The first ``L`` is the most likely one
    for shot noise alone, ``sum(e_i) / sum(k_i)``.
    """
    samples = electrons.shape[1:]
    signal = electrons * usable
    lost = ~usable.any(axis=0)
    estimate = np.zeros(samples, np.float32)
    precision = np.zeros(samples, np.float32)
    for k, e, u in zip(collection, signal, usable, strict=True):
        estimate += e
        precision += u * np.float32(k)
    for _ in range(_ROUNDS):
        np.divide(estimate, precision, out=estimate, where=~lost)
        np.maximum(estimate, 0, out=estimate)
        pooled = estimate
        estimate = np.zeros(samples, np.float32)
        precision = np.zeros(samples, np.float32)
        for k, n, e, u in zip(collection, noise, signal, usable, strict=True):
            weight = pooled * np.float32(k)
            weight += n
            np.divide(np.float32(k), weight, out=weight)
            estimate += weight * e
            weight *= u * np.float32(k)
            precision += weight
    precision[lost] = 1
    estimate /= precision
    variance = np.reciprocal(precision)
    saturated = int(np.count_nonzero(lost))
    if saturated:
        estimate[lost] = electrons[0][lost] / np.float32(collection[0])
        variance[lost] = np.float32((UNKNOWN_DEVIATION * full_scale) ** 2)
    return estimate, variance, saturated


def electrons_of_counts(camera: CameraNumbers, options: MergeOptions) -> Float:
    """Return the electrons above the nominal black level behind each count, float32."""
    span = camera.white_level - camera.black_level_counts
    level = (np.arange(camera.white_level + 1) - camera.black_level_counts) / span
    if options.response is not None:
        fraction = options.response.linearise(level)
    else:
        fraction = np.copysign(np.abs(level) ** camera.response_gamma, level)
    return (fraction * camera.full_well_electrons).astype(np.float32)


def _fixed_noise(camera: CameraNumbers, background: Float, options: MergeOptions) -> Float:
    """Variance in electrons squared that doesn't come from the signal, (E, *frame).

    Read noise, dark current and the shot noise of light in the all-off frames (the projector's
    black level), each twice: in the frame, and in the mean that is subtracted.
    """
    shape = (-1, *(1,) * (background.ndim - 1))
    dark = camera.dark_current_electrons * np.reshape(camera.exposures, shape)
    variance = camera.read_noise_electrons**2 + dark
    # the converter's noise is of the frame alone: in the mean it's averaged and dithered
    quantum = camera.electrons_per_count**2 / 12
    glow = background - dark
    error = np.sqrt((variance + quantum) / options.black_count)
    glow[glow < _GLOW_SIGNIFICANCE * error] = 0
    noise = (variance + glow) * (1 + 1 / options.black_count) + quantum / options.black_count
    return np.asarray(noise, np.float32)
