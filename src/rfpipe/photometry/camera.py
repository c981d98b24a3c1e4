"""The camera model and its inverse: radiance to counts, and counts to radiance [App. B]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Counts, Float
from rfpipe.errors import InputError
from rfpipe.photometry.demosaic import check_mosaic, demosaic, mosaic
from rfpipe.photometry.sensor import (
    ExactSensor,
    MergedImages,
    Sensor,
    check_black,
    check_frames,
    check_light,
    check_shape,
)
from rfpipe.provenance import generator
from rfpipe.units import COUNTS, RADIANCE, SATURATION_FRACTION

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig


_EXACT_POISSON_BELOW = 64.0
# Mean electrons below which shot noise is drawn from the Poisson distribution; from there on it
# is a rounded Gaussian of the same mean and variance (skewness of the true one: at most 1/8).

UNKNOWN_DEVIATION = 0.125
"""Standard deviation of a sample saturated in every exposure, in units of the full scale. The value
is significant, with eight standard deviations, but has a small weight, since only a lower bound of
the light is known."""

_ROUNDS = 2
# Iterations of the weights from the pooled estimate. A third one changes the result by less than
# 0.001 standard deviations (RMS), and at most 0.01.

_GLOW_SIGNIFICANCE = 4.0
# Electrons in the all-off frames count as more than the dark current above this many standard
# deviations of their noise; its shot noise then enters the variance.

_SAMPLES = 2**14  # number of samples merged at a time, so that intermediate arrays fit the cache


@dataclass(frozen=True)
class CameraModel(Sensor):
    """A camera with photon and read noise, limited wells and a converter of few bits.

    Radiance -> lens -> mosaic -> electrons of each exposure (Poisson), full well, read noise
    -> response, gain, black level, rounding -> counts; `merge` is the inverse.

    The parameters, their units and ranges are those of `rfpipe.config.CameraConfig`.

    Raises
    ------
    InputError
        When a setting is out of range.
    """

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

        from rfpipe.config.camera import CameraConfig
        from rfpipe.config.mistakes import mistake_lines

        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        try:
            CameraConfig.model_validate(settings)
        except ValidationError as error:
            raise InputError(f"camera: {mistake_lines(error)[0]}") from None

    @property
    def white_level(self) -> int:
        """Full scale in counts: the level of saturation, or the largest count of the bits."""
        return int(2**self.bits) - 1 if self.white_level_counts is None else self.white_level_counts

    @property
    def full_scale_radiance(self) -> float:
        """Radiance that fills a pixel's well in the shortest exposure."""
        return self.full_well_electrons / (self.electrons_per_radiance * self.exposures[0])

    @property
    def electrons_per_count(self) -> float:
        """Gain of a linear camera, whose full well gives full scale."""
        return self.full_well_electrons / (self.white_level - self.black_level_counts)

    @property
    def frame_dtype(self) -> np.dtype[Any]:
        """Frames are uint16 counts."""
        return np.dtype(COUNTS)

    def frame_shape(self, camera_shape: tuple[int, ...], channels: int) -> tuple[int, ...]:
        """Shape of one bracket: (E, *camera_shape, C), or (E, *camera_shape) under a mosaic."""
        if self.bayer is None:
            return (len(self.exposures), *camera_shape, channels)
        check_mosaic(camera_shape, channels)
        return (len(self.exposures), *camera_shape)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.white_level_counts is None:  # keeps fingerprints without this setting
            del settings["white_level_counts"]
        return {"kind": "camera", **settings, "exposures": list(self.exposures)}

    def expose(self, radiance: NDArray[Any], seed: int, key: tuple[int, ...]) -> Counts:
        """Take one bracket of a radiance image (*camera_shape, C); see `Sensor.expose`.

        Returns counts, uint16 of shape `frame_shape`, 0 to `white_level`. InputError when the image
        can't be sampled through the mosaic.
        """
        light = apply_optics(
            check_light(radiance, key), self.psf_sigma, self.vignetting, self.flare
        )
        frames = np.empty(self.frame_shape(light.shape[:-1], light.shape[-1]), COUNTS)
        if self.bayer is not None:
            light = mosaic(light, self.bayer)
        for index, exposure in enumerate(self.exposures):
            frames[index] = self._frame(light, exposure, generator(seed, *key, index))
        return frames

    def bracket_merge(self, black: NDArray[Any], black_count: int = 1) -> CountsMerge:
        """Prepare a merge of brackets to radiance with its variance.

        Notes
        -----
        A response_gamma above 1 is steep at the black level. If the black level is so low that read
        noise is clipped, or the dark current is below the read noise, the mean of the non-linear
        counts is biased, and dark radiance is off by a fraction of its noise.
        """
        return CountsMerge(self, black, black_count)

    def _frame(self, light: Float, exposure: float, random: np.random.Generator) -> Counts:
        """Take one exposure of the light on the sensor."""
        mean = light * np.float32(self.electrons_per_radiance * exposure)
        mean += np.float32(self.dark_current_electrons * exposure)
        electrons = random.standard_normal(mean.shape, np.float32)
        electrons *= np.sqrt(mean)
        electrons += mean
        np.rint(electrons, out=electrons)
        few = mean < _EXACT_POISSON_BELOW
        electrons[few] = random.poisson(mean[few])
        np.clip(electrons, 0, self.full_well_electrons, out=electrons)
        if self.read_noise_electrons > 0:
            read = random.standard_normal(mean.shape, np.float32)
            read *= np.float32(self.read_noise_electrons)
            electrons += read
        electrons /= np.float32(self.full_well_electrons)
        if self.response_gamma != 1:
            level = np.abs(electrons.astype(np.float64)) ** (1 / self.response_gamma)
            electrons = np.copysign(level, electrons).astype(np.float32)
        electrons *= self.white_level - self.black_level_counts
        electrons += self.black_level_counts
        np.rint(electrons, out=electrons)
        return np.clip(electrons, 0, self.white_level, out=electrons).astype(COUNTS)


def sensor_from_config(config: CameraConfig | None) -> Sensor:
    """Create the sensor of a run's settings: a camera, or exact radiance for None."""
    if config is None:
        return ExactSensor()
    return CameraModel(**config.model_dump())


def apply_optics(radiance: Float, psf_sigma: float, vignetting: float, flare: float) -> Float:
    """Apply the lens to an image: blur, vignetting and flare, separately by view and channel.

    All effects are linear in the radiance.

    Parameters
    ----------
    radiance : ndarray of float32, shape (*camera_shape, C)
        Not negative.
    psf_sigma : float
        Standard deviation of the Gaussian point spread in pixels, 0 for none. The image is
        mirrored at its borders, so that no light is lost there.
    vignetting : float
        Fraction of the light lost in the corners by cos^4 falloff, in [0, 1).
    flare : float
        Fraction of a view's light that is spread evenly over the view, in [0, 1).

    Returns
    -------
    ndarray of float32, shape (*camera_shape, C)
    """
    image = radiance
    if psf_sigma > 0:
        from scipy.ndimage import gaussian_filter

        image = gaussian_filter(image, psf_sigma, axes=(-3, -2), mode="reflect")
    if vignetting > 0:
        image = image * _falloff(image.shape[-3], image.shape[-2], vignetting)
    if flare > 0:
        mean = image.mean(axis=(-3, -2), keepdims=True, dtype=np.float64)
        image = (1 - flare) * image + (flare * mean).astype(np.float32)
    return np.asarray(image, np.float32)


def _falloff(height: int, width: int, vignetting: float) -> Float:
    """cos^4 of the field angle, 1 at the centre and ``1 - vignetting`` in the corners."""
    y = np.arange(height) - (height - 1) / 2
    x = np.arange(width) - (width - 1) / 2
    radius_squared = y[:, None] ** 2 + x[None, :] ** 2
    corner = radius_squared[0, 0]
    if corner == 0:  # a single pixel is its own centre
        return np.ones((height, width, 1), np.float32)
    tangent_squared = (1 - vignetting) ** -0.5 - 1
    falloff = (1 + tangent_squared * radius_squared / corner) ** -2.0
    return np.asarray(falloff[..., None], np.float32)


class CountsMerge:
    """Merge of a camera's brackets, for a mean of the all-off frames (E, ...) in counts."""

    def __init__(self, camera: CameraModel, black: NDArray[Any], black_count: int) -> None:
        black = np.asarray(black, np.float32)
        check_black(black, len(camera.exposures))
        self._camera = camera
        self._shape = black.shape
        self._collection = [
            camera.electrons_per_radiance * exposure for exposure in camera.exposures
        ]
        self._full_scale = camera.full_scale_radiance
        self._usable_below = COUNTS(np.ceil(SATURATION_FRACTION * camera.white_level))
        self._is_linear = camera.response_gamma == 1
        table = electrons_of_counts(camera)
        if self._is_linear:
            background = black - np.float32(camera.black_level_counts)
            background *= np.float32(camera.electrons_per_count)
        else:
            background = np.interp(black, np.arange(len(table)), table).astype(np.float32)
        # the size of a count in electrons is the slope of the inverse response
        steps = np.square(np.gradient(table)).astype(np.float32) / 12
        noise = _fixed_noise(camera, background, black_count)
        self._table, self._steps = table, steps
        self._background = (black if self._is_linear else background).reshape(len(black), -1)
        self._noise = (noise + steps[0] if self._is_linear else noise).reshape(len(black), -1)

    def __call__(self, frames: NDArray[Any], first_index: int = 0) -> MergedImages:
        """Merge brackets ``(B, *frame_shape)``; see `BracketMerge`."""
        frames = np.asarray(frames)
        check_shape(frames, self._shape, first_index)
        check_frames(frames, self._camera.white_level, first_index)
        count, exposures, *image = frames.shape
        flat = frames.reshape(count, exposures, prod(image))
        radiance, variance = np.empty((2, count, flat.shape[-1]), RADIANCE)
        saturated = 0
        for index, bracket in enumerate(flat):
            for first in range(0, flat.shape[-1], _SAMPLES):
                part = slice(first, first + _SAMPLES)
                counts, noise = bracket[:, part], self._noise[:, part]
                if self._is_linear:
                    electrons = counts - self._background[:, part]
                    electrons *= np.float32(self._camera.electrons_per_count)
                else:
                    electrons = self._table[counts] - self._background[:, part]
                    noise = noise + self._steps[counts]
                usable = counts < self._usable_below
                result = merge_bracket(
                    electrons, usable, self._collection, list(noise), self._full_scale
                )
                radiance[index, part], variance[index, part], part_saturated = result
                saturated += part_saturated
        merged = radiance.reshape(count, *image), variance.reshape(count, *image)
        if self._camera.bayer is not None:
            merged = demosaic(*merged, self._camera.bayer)
        return MergedImages(*merged, saturated)


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
    is_saturated = ~usable.any(axis=0)
    estimate = np.zeros(samples, np.float32)
    precision = np.zeros(samples, np.float32)
    for k, e, u in zip(collection, signal, usable, strict=True):
        estimate += e
        precision += u * np.float32(k)
    for _ in range(_ROUNDS):
        np.divide(estimate, precision, out=estimate, where=~is_saturated)
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
    precision[is_saturated] = 1
    estimate /= precision
    variance = np.reciprocal(precision)
    saturated = int(np.count_nonzero(is_saturated))
    if saturated:
        estimate[is_saturated] = electrons[0][is_saturated] / np.float32(collection[0])
        variance[is_saturated] = np.float32((UNKNOWN_DEVIATION * full_scale) ** 2)
    return estimate, variance, saturated


def are_saturated(radiance: Float, variance: Float) -> NDArray[np.bool_]:
    """Find samples, in pictures of one scene, that were saturated in every exposure.

    They have the brightness of the brightest sample and the standard deviation `UNKNOWN_DEVIATION`,
    within 10 %; no other sample is both bright and so uncertain. Samples that aren't finite are
    not marked.
    """
    known = np.isfinite(radiance) & np.isfinite(variance)
    brightest = radiance.max(initial=0, where=known)
    uncertain = variance > np.square(0.9 * UNKNOWN_DEVIATION * radiance)
    return np.asarray(known & uncertain & (radiance > 0.9 * brightest))


def electrons_of_counts(camera: CameraModel) -> Float:
    """Return the electrons above the nominal black level behind each count, float32."""
    span = camera.white_level - camera.black_level_counts
    level = (np.arange(camera.white_level + 1) - camera.black_level_counts) / span
    fraction = np.copysign(np.abs(level) ** camera.response_gamma, level)
    return (fraction * camera.full_well_electrons).astype(np.float32)


def _fixed_noise(camera: CameraModel, background: Float, black_count: int) -> Float:
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
    error = np.sqrt((variance + quantum) / black_count)
    glow[glow < _GLOW_SIGNIFICANCE * error] = 0
    noise = (variance + glow) * (1 + 1 / black_count) + quantum / black_count
    return np.asarray(noise, np.float32)
