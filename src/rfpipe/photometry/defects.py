"""Hot, dead and stuck pixels in the first frames, and a floodlit image without light."""

from __future__ import annotations

from dataclasses import dataclass
from math import erf, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.sensor import Sensor

Mask = NDArray[np.bool_]

SIGNIFICANCE = 5.0
"""Standard deviations, beyond what the largest of as many good pixels reaches."""

MAD_TO_DEVIATION = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""


@dataclass(frozen=True, eq=False)
class DefectMap:
    """Pixels not to be trusted.

    Parameters
    ----------
    mask : ndarray of bool, shape (*camera_shape)
        The defects and, under a colour mosaic, their neighbours, which are filled from them.
    hot, dead : int
        Pixels with an outlying black level or noise; others that read the same whatever happens.
    """

    mask: Mask
    hot: int
    dead: int


class DarkFrames:
    """Mean, variance and range of the all-off brackets, which pass by a few at a time.

    The first two are sums in float64: of counts they are exact, whatever comes together.

    Attributes
    ----------
    count : int
        Brackets seen.
    smallest, largest : ndarray, shape (E, ...)
        The smallest and the largest value of each sample, in the brackets' dtype.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first = self._total = self._squares = np.zeros(0)
        self.smallest: NDArray[Any] = np.zeros(0)
        self.largest: NDArray[Any] = np.zeros(0)

    @classmethod
    def of(cls, frames: NDArray[Any]) -> DarkFrames:
        """Return those of brackets (K, E, ...) at hand."""
        dark = cls()
        dark.add(frames)
        return dark

    def add(self, frames: NDArray[Any]) -> None:
        """Take brackets (B, E, ...) into account."""
        for bracket in frames:
            if not self.count:
                self._first = bracket.astype(np.float64)
                self._total, self._squares = np.zeros((2, *bracket.shape))
                self.smallest = self.largest = bracket
            self._total += bracket
            # about the first one, so that a high black level doesn't drown its noise
            self._squares += np.square(bracket - self._first)
            self.smallest, self.largest = (
                np.minimum(self.smallest, bracket),
                np.maximum(self.largest, bracket),
            )
            self.count += 1

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean of each sample, shape (E, ...)."""
        return np.asarray(self._total / self.count)

    @property
    def variance(self) -> NDArray[np.float64]:
        """Variance of each sample between brackets, shape (E, ...); takes two or more."""
        shift = self._total - self.count * self._first
        spread = np.maximum(self._squares - np.square(shift) / self.count, 0)
        return np.asarray(spread / (self.count - 1))


def find_defects(dark: DarkFrames, floodlit_frames: NDArray[Any], sensor: Sensor) -> DefectMap:
    """Find pixels that are hot, dead or stuck, by dark frames and a floodlit bracket (E, ...).

    Notes
    -----
    Hot: the mean of the black frames, or (with two or more) their variance, is an outlier of any
    exposure, relative to the robust spread over pixels. Dead or stuck: all frames of an exposure,
    the floodlit one among them, hold the same count. A pixel that merely sees no light has the
    noise of any other and is none of these, whatever its neighbours see. Where the converter's
    steps hide that noise a constant count says nothing, and no pixel is called dead.
    """
    hot = find_hot(dark)
    dead = _constant(dark, floodlit_frames)
    has_channels = len(sensor.frame_shape((2, 2), 3)) == 4
    if not has_channels:
        hot, dead = hot[..., None], dead[..., None]
    hot_pixels, dead_pixels = hot.any(axis=-1), dead.any(axis=-1)
    mask: Mask = np.asarray(hot_pixels | dead_pixels)
    if not has_channels:
        from scipy.ndimage import binary_dilation

        # by one pixel in each direction of the image, the reach of the demosaic
        mask = binary_dilation(mask, np.ones((*(1,) * (mask.ndim - 2), 3, 3), bool))
    return DefectMap(mask, int(hot_pixels.sum()), int((dead_pixels & ~hot_pixels).sum()))


def find_hot(dark: DarkFrames) -> Mask:
    """Find the photosites with an outlying black level or noise: bool, shape of a frame."""
    # the mean of dark frames is no more certain than their rounding
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


def _constant(dark: DarkFrames, floodlit_frames: NDArray[Any]) -> Mask:
    """Find photosites that hold one count in all frames of each exposure, and can't by chance."""
    constant: Mask = (dark.smallest == dark.largest) & (floodlit_frames == dark.smallest)
    # a black level at the converter's lower end cuts the noise off
    constant &= ~((dark.smallest == 0) & (np.median(dark.smallest) == 0))
    stuck: Mask = np.asarray(constant.all(axis=0))
    if dark.count < 2:
        return np.zeros_like(stuck)
    chance = log(constant[0].size)
    for variance in dark.variance:
        # of the noise before its rounding [Sheppard 1898]
        deviation = np.sqrt(max(float(np.median(variance)) - 1 / 12, 0.0))
        # a good photosite holds one count most easily where its mean is just that count
        once = erf(1 / (np.sqrt(8) * deviation)) if deviation else 1.0
        chance += (dark.count + 1) * log(once)
    return stuck if chance < -(SIGNIFICANCE**2) / 2 else np.zeros_like(stuck)


def _threshold(size: int) -> float:
    """Deviations that none of `size` good Gaussian pixels exceeds."""
    return SIGNIFICANCE + float(np.sqrt(2 * np.log(max(size, 2))))


def _noisy(variance: NDArray[np.float64], freedom: int, floor: float) -> Mask:
    """Find pixels whose variance, of so many degrees of freedom, is an outlier.

    The cube root of a chi-squared variable is close to Gaussian (Wilson and Hilferty 1931).
    """
    spread = 2 / (9 * freedom)
    # the median of a chi-squared variable over its mean
    typical = max(float(np.median(variance)) / (1 - spread) ** 3, floor**2)
    score = (np.cbrt(variance / typical) - (1 - spread)) / np.sqrt(spread)
    outlying: Mask = score > _threshold(variance.size)
    return outlying


def check_floodlit(
    radiance: NDArray[Any],
    variance: NDArray[Any],
    remedy: str = "Check that the projector is on, and that the exposures are long enough",
) -> None:
    """Raise CaptureError where the floodlit image is below the black level or black.

    Light must exceed `SIGNIFICANCE` standard deviations of noise in the sum over the image or,
    beyond what the largest of as many noisy samples reaches, in a sample. `remedy` is what to do
    about a black image.
    """
    image = np.asarray(radiance, np.float64)
    spread = np.asarray(variance, np.float64)
    total, error = float(image.sum()), float(np.sqrt(spread.sum()))
    if total < -SIGNIFICANCE * error:
        raise CaptureError(
            f"the floodlit image is darker than the all-off one: radiance {total:.3g} in all, "
            f"noise {error:.3g}. The black level is above the signal: check that the all-off "
            "frames were taken in the dark, with this camera and these exposures"
        )
    lit = image > _threshold(image.size) * np.sqrt(spread)
    if total <= SIGNIFICANCE * error and not lit.any():
        raise CaptureError(
            f"the floodlit image is all black: radiance {total:.3g} in all, noise {error:.3g}. "
            f"{remedy}"
        )
