"""A camera's numbers, and the merge of its brackets: what they share is worked out once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.photometry.demosaic import demosaic
from rfpipe.photometry.hdr import ROUNDS, UNKNOWN_DEVIATION, merge_bracket
from rfpipe.photometry.sensor import Merged, MergeOptions, check_black, check_frames, check_shape
from rfpipe.units import COUNTS, RADIANCE

__all__ = ["CameraNumbers", "CountsMerge", "electrons_of_counts"]

Float = NDArray[np.float32]

GLOW_SIGNIFICANCE = 4.0
"""Electrons in the all-off frames count as more than the dark current above this many standard
deviations of their noise; its shot noise then enters the variance."""

COMPILED_AFTER = 2**25
"""Counts to merge, or merged already, from which on the compiled kernel is loaded: NumPy takes as
long for so many as the loading takes. Both give the same bits."""


@dataclass(frozen=True)
class CameraNumbers:
    """What makes a camera's counts; see `rfpipe.photometry.camera.CameraModel`, which explains it.

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
        from rfpipe.config.problems import explained

        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        try:
            CameraConfig.model_validate(settings)
        except ValidationError as error:
            raise InputError(f"camera: {explained(CameraConfig, error, settings)[0]}") from None

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
        self._background = black if self._is_linear else background
        self._noise = noise + steps[0] if self._is_linear else noise
        self._known = options.brackets * black.size  # counts merged, or sure to come

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
        merge = self._by_kernel if self._known >= COMPILED_AFTER else self._by_numpy
        self._known += frames.size
        radiance, variance = np.empty((2, len(frames), *self._shape[1:]), RADIANCE)
        saturated = merge(frames, radiance, variance)
        if self._camera.bayer is None:
            return Merged(radiance, variance, saturated)
        return Merged(*demosaic(radiance, variance, self._camera.bayer), saturated)

    def _by_numpy(self, frames: NDArray[Any], radiance: Float, variance: Float) -> int:
        saturated = 0
        for index, bracket in enumerate(frames):
            if self._is_linear:
                electrons = bracket - self._background
                electrons *= np.float32(self._camera.electrons_per_count)
                noise: Sequence[Float] = list(self._noise)
            else:
                electrons = self._table[bracket] - self._background
                noise = list(self._noise + self._steps[bracket])
            radiance[index], variance[index], lost = merge_bracket(
                electrons, bracket < self._usable_below, self._collection, noise, self._full_scale
            )
            saturated += lost
        return saturated

    def _by_kernel(self, frames: NDArray[Any], radiance: Float, variance: Float) -> int:
        from rfpipe.photometry.kernels import merge_counts

        count, exposures = frames.shape[:2]
        flat = (count, exposures, -1)
        none = np.zeros(0, np.float32)
        saturated = merge_counts(
            np.ascontiguousarray(frames, COUNTS).reshape(flat),
            self._background.reshape(flat[1:]),
            self._noise.reshape(flat[1:]),
            none if self._is_linear else self._table,
            none if self._is_linear else self._steps,
            np.float32(self._camera.electrons_per_count),
            self._usable_below,
            np.array(self._collection, np.float32),
            np.float32((UNKNOWN_DEVIATION * self._full_scale) ** 2),
            ROUNDS,
            radiance.reshape(count, -1),
            variance.reshape(count, -1),
        )
        return int(saturated)


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
    glow[glow < GLOW_SIGNIFICANCE * error] = 0
    noise = (variance + glow) * (1 + 1 / options.black_count) + quantum / options.black_count
    return np.asarray(noise, np.float32)
