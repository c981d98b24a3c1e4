"""Hot, dead and stuck pixels in the first frames, and a floodlit image without light."""

from __future__ import annotations

from dataclasses import dataclass
from math import erf, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools
from rfpipe.errors import CaptureError
from rfpipe.photometry.sensor import Sensor

DEFECT_SIGNIFICANCE = 5.0
"""Standard deviations, beyond what the largest of as many good pixels reaches."""

MAD_TO_DEVIATION = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""


@dataclass(frozen=True, eq=False)
class DefectMap:
    """Map of defective pixels.

    Parameters
    ----------
    mask : ndarray of bool, shape (*camera_shape)
        The defects and, under a colour mosaic, their neighbours, whose colours depend on them.
    hot, dead : int
        Numbers of pixels with an outlying black level or noise, and of others with constant counts.
    """

    mask: Bools
    hot: int
    dead: int


class FrameRange:
    """Range of brackets of any patterns, accumulated one by one.

    Attributes
    ----------
    count : int
        Number of brackets.
    smallest, largest : ndarray, shape (E, ...)
        The smallest and the largest value of each sample, in the brackets' dtype.
    """

    def __init__(self) -> None:
        self.count = 0
        self.smallest: NDArray[Any] = np.zeros(0)
        self.largest: NDArray[Any] = np.zeros(0)

    def add(self, frames: NDArray[Any]) -> None:
        """Add brackets (B, E, ...)."""
        for bracket in frames:
            is_first = not self.count
            self.smallest = bracket if is_first else np.minimum(self.smallest, bracket)
            self.largest = bracket if is_first else np.maximum(self.largest, bracket)
            self.count += 1


class DarkFrames(FrameRange):
    """Mean, variance and range of all-off brackets, accumulated in batches.

    Sums are float64, which is exact for counts, so that batches don't affect the result.
    """

    def __init__(self) -> None:
        super().__init__()
        self._first = self._total = self._squares = np.zeros(0)

    @classmethod
    def of(cls, frames: NDArray[Any]) -> DarkFrames:
        """Accumulate brackets (K, E, ...)."""
        dark = cls()
        dark.add(frames)
        return dark

    def add(self, frames: NDArray[Any]) -> None:
        """Add brackets (B, E, ...)."""
        for bracket in frames:
            if not self.count:
                self._first = bracket.astype(np.float64)
                self._total, self._squares = np.zeros((2, *bracket.shape))
            self._total += bracket
            # relative to the first bracket, against rounding errors at a high black level
            self._squares += np.square(bracket - self._first)
            super().add(bracket[None])

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean of each sample, shape (E, ...)."""
        return np.asarray(self._total / self.count)

    @property
    def variance(self) -> NDArray[np.float64]:
        """Variance of each sample between two or more brackets, shape (E, ...)."""
        spread = self._total - self.count * self._first
        np.square(spread, out=spread)
        spread /= self.count
        np.subtract(self._squares, spread, out=spread)
        np.maximum(spread, 0, out=spread)
        spread /= self.count - 1
        return spread


def find_defects(dark: DarkFrames, lit: FrameRange, sensor: Sensor) -> DefectMap:
    """Find pixels that are hot, dead or stuck, from dark frames and the range of lit ones.

    Notes
    -----
    Hot: the mean of the black frames, or (with two or more) their variance, is an outlier of any
    exposure, relative to the robust spread over pixels. Dead or stuck: all frames of an exposure,
    including the lit ones, have the same count. A pixel that receives no light has the noise of
    any other pixel and is not a defect. Where rounding hides the noise, constant counts are no
    evidence, and no pixel is dead.
    """
    hot = find_hot(dark)
    dead = _constant(dark, lit)
    has_channels = len(sensor.frame_shape((2, 2), 3)) == 4
    if not has_channels:
        hot, dead = hot[..., None], dead[..., None]
    hot_pixels, dead_pixels = hot.any(axis=-1), dead.any(axis=-1)
    mask: Bools = np.asarray(hot_pixels | dead_pixels)
    if not has_channels:
        from scipy.ndimage import binary_dilation

        # by one pixel in each direction, the support of the demosaicing filter
        mask = binary_dilation(mask, np.ones((*(1,) * (mask.ndim - 2), 3, 3), bool))
    return DefectMap(mask, int(hot_pixels.sum()), int((dead_pixels & ~hot_pixels).sum()))


def find_hot(dark: DarkFrames) -> Bools:
    """Find the photosites with an outlying black level or noise: bool, shape of a frame."""
    # the mean of dark frames has at least the uncertainty of their rounding
    floor = float(1 / np.sqrt(12)) / np.sqrt(dark.count)
    count, black = dark.count, dark.mean
    variance = dark.variance if count > 1 else None
    hot = np.zeros(black.shape[1:], bool)
    for exposure, mean in enumerate(black):
        apart = np.abs(mean - float(np.median(mean)))
        deviation = MAD_TO_DEVIATION * float(np.median(apart))
        hot |= apart > _threshold(mean.size) * max(deviation, floor)
        if variance is not None:
            hot |= _noisy(variance[exposure], count - 1, floor * np.sqrt(count))
    return hot


def _constant(dark: DarkFrames, lit: FrameRange) -> Bools:
    """Find photosites with constant counts in all frames, unless this is possible by chance."""
    constant: Bools = (dark.smallest == dark.largest) & (lit.smallest == dark.smallest)
    constant &= lit.largest == dark.smallest
    none = np.zeros(constant.shape[1:], np.bool_)
    if dark.count < 2 or not constant.all(axis=0).any():
        return none
    # a black level at 0 counts clips the noise
    constant &= ~((dark.smallest == 0) & (np.median(dark.smallest) == 0))
    stuck: Bools = np.asarray(constant.all(axis=0))
    chance = log(constant[0].size)
    for variance in dark.variance:
        # standard deviation of the noise before rounding [Sheppard 1898]
        deviation = np.sqrt(max(float(np.median(variance)) - 1 / 12, 0.0))
        # constant counts are most probable for a mean at an integer
        once = erf(1 / (np.sqrt(8) * deviation)) if deviation else 1.0
        chance += (dark.count + lit.count) * log(once)
    return stuck if chance < -(DEFECT_SIGNIFICANCE**2) / 2 else none


def _threshold(size: int) -> float:
    """Standard deviations that no pixel out of `size` good Gaussian ones exceeds."""
    return DEFECT_SIGNIFICANCE + float(np.sqrt(2 * np.log(max(size, 2))))


def _noisy(variance: NDArray[np.float64], freedom: int, floor: float) -> Bools:
    """Find pixels whose variance, with `freedom` degrees of freedom, is an outlier.

    The cube root of a chi-squared variable is close to Gaussian (Wilson and Hilferty 1931).
    """
    spread = 2 / (9 * freedom)
    # the mean of a chi-squared variable from its median
    typical = max(float(np.median(variance)) / (1 - spread) ** 3, floor**2)
    score = (np.cbrt(variance / typical) - (1 - spread)) / np.sqrt(spread)
    outlying: Bools = score > _threshold(variance.size)
    return outlying


def check_floodlit(
    radiance: NDArray[Any],
    variance: NDArray[Any],
    remedy: str = "Check that the projector is on, and that the exposures are long enough",
) -> None:
    """Raise CaptureError if the floodlit image is black or darker than the black level.

    Light must exceed the noise by `DEFECT_SIGNIFICANCE` standard deviations, either in the sum over
    the image or in a single sample, there beyond the expected maximum of pure noise. `remedy` is
    the advice for a black image.
    """
    image = np.asarray(radiance, np.float64)
    spread = np.asarray(variance, np.float64)
    total, error = float(image.sum()), float(np.sqrt(spread.sum()))
    if total < -DEFECT_SIGNIFICANCE * error:
        raise CaptureError(
            f"the floodlit image is darker than the all-off one: radiance {total:.3g} in all, "
            f"noise {error:.3g}. The black level is above the signal: check that the all-off "
            "frames were taken in the dark, with this camera and these exposures"
        )
    lit = image > _threshold(image.size) * np.sqrt(spread)
    if total <= DEFECT_SIGNIFICANCE * error and not lit.any():
        raise CaptureError(
            f"the floodlit image is all black: radiance {total:.3g} in all, noise {error:.3g}. "
            f"{remedy}"
        )
