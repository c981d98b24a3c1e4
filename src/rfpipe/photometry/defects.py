"""Hot, dead and stuck pixels: finding them in the first frames, and filling them in."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.sensor import Sensor

__all__ = ["DarkFrames", "DefectMap", "Repair", "find_defects", "find_hot", "repair"]

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]

SIGNIFICANCE = 5.0
"""Standard deviations, beyond what the largest of as many good pixels reaches."""

NEIGHBOUR_RATIO = 10.0
"""A pixel without response is dead where its neighbours respond by this many times what would
have been seen in it."""

MAD_TO_DEVIATION = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""


@dataclass(frozen=True, eq=False)
class DefectMap:
    """Pixels not to be trusted.

    Parameters
    ----------
    mask : ndarray of bool, shape (*camera_shape)
        Pixels to repair: the defects and, under a colour mosaic, their neighbours, which the
        interpolation fills from them.
    hot : int
        Pixels with an outlying black level or noise.
    dead : int
        Pixels that don't respond to light, stuck at any value.
    """

    mask: Mask
    hot: int
    dead: int


class DarkFrames:
    """Mean and variance of the all-off brackets, which pass by a few at a time.

    Both are sums in float64: of counts they are exact, whatever comes together.

    Attributes
    ----------
    count : int
        Brackets seen.
    dtype : numpy.dtype
        Theirs.
    shape : tuple of int
        (E, ...), theirs.
    """

    def __init__(self) -> None:
        self.count = 0
        self.dtype: np.dtype[Any] = np.dtype(np.float64)
        self.shape: tuple[int, ...] = ()
        self._first = self._total = self._squares = np.zeros(0)

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
                self.dtype, self.shape = bracket.dtype, bracket.shape
                self._first = bracket.astype(np.float64)
                self._total, self._squares = np.zeros(self.shape), np.zeros(self.shape)
            self._total += bracket
            # about the first one, so that a high black level doesn't drown its noise
            self._squares += np.square(bracket - self._first)
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
    """Find the pixels that are hot, dead or stuck.

    Parameters
    ----------
    dark : DarkFrames
        Of brackets of the all-off pattern as the sensor gives them.
    floodlit_frames : ndarray, shape (E, ...)
        A bracket of the all-on pattern.
    sensor : Sensor
        Tells frames with channels from those of a colour mosaic.

    Returns
    -------
    DefectMap

    Raises
    ------
    CaptureError
        When the shapes don't belong together.

    Notes
    -----
    Hot: the mean of the black frames, or (with two or more) their variance, is an outlier of any
    exposure, relative to the robust spread over pixels. Dead or stuck: in no exposure does the
    floodlit frame differ from the black one by more than noise, while all neighbours but one
    (of the same colour) do, by `NEIGHBOUR_RATIO` times that. So a black surface is not taken for
    dead unless it is a pixel or two in size.
    """
    if len(dark.shape) < 3 or dark.shape != floodlit_frames.shape:
        raise CaptureError(
            f"all-off frames {dark.shape} and floodlit frames {floodlit_frames.shape} don't belong "
            "together; expected both to be (exposures, ...)"
        )
    count = dark.count
    black = dark.mean
    floor = _rounding(dark.dtype, floodlit_frames) / np.sqrt(count)
    hot, noise = _hot(dark, floor)
    signal = np.abs(floodlit_frames - black)
    visible = _threshold(hot.size) * noise
    response = (signal / np.maximum(visible, np.finfo(np.float64).tiny)).max(axis=0)
    has_channels = len(sensor.frame_shape((2, 2), 3)) == 4
    if not has_channels:
        hot, response = hot[..., None], response[..., None]
    # under a mosaic, the next photosite of the same colour is two pixels away
    dead = (response <= 1) & _alone(response > NEIGHBOUR_RATIO, 1 if has_channels else 2)
    hot_pixels, dead_pixels = hot.any(axis=-1), dead.any(axis=-1)
    mask = hot_pixels | dead_pixels
    if not has_channels:
        mask = _grown(mask)
    return DefectMap(mask, int(hot_pixels.sum()), int((dead_pixels & ~hot_pixels).sum()))


def find_hot(dark: DarkFrames) -> Mask:
    """Find the photosites with an outlying black level or noise, from dark frames of counts.

    Parameters
    ----------
    dark : DarkFrames
        Of uint16 counts.

    Returns
    -------
    ndarray of bool, shape of a frame
    """
    floor = _rounding(dark.dtype, np.zeros(1)) / np.sqrt(dark.count)
    return _hot(dark, floor)[0]


def _hot(dark: DarkFrames, floor: float) -> tuple[Mask, NDArray[np.float64]]:
    """Return the hot photosites, and each exposure's deviation of one frame, (E, ...)."""
    count, black = dark.count, dark.mean
    variance = dark.variance if count > 1 else None
    hot = np.zeros(black.shape[1:], bool)
    noise = np.zeros_like(black)
    for exposure, mean in enumerate(black):
        centre, deviation = _robust(mean)
        deviation = max(deviation, floor)
        hot |= np.abs(mean - centre) > _threshold(mean.size) * deviation
        # one frame is noisier than the mean of all
        noise[exposure] = deviation * np.sqrt(count)
        if variance is not None:
            hot |= _noisy(variance[exposure], count - 1, floor * np.sqrt(count))
    return hot, noise


def repair(radiance: Float, variance: Float, mask: Mask) -> tuple[Float, Float]:
    """Replace defective pixels by the median of their valid neighbours.

    Parameters
    ----------
    radiance, variance : ndarray of float32, shape (..., *camera_shape, C)
    mask : ndarray of bool, shape (*camera_shape)
        True where defective.

    Returns
    -------
    radiance, variance : ndarray of float32
        Copies, or the inputs where nothing is masked. The variance is the neighbours' largest
        plus the variance among them.

    Raises
    ------
    InputError
        When the mask doesn't fit the images.
    CaptureError
        When a view has no valid pixel.
    """
    return Repair(mask)(radiance, variance)


class Repair:
    """`repair` of one mask: where the neighbours are is found once; threads may share it."""

    def __init__(self, mask: Mask) -> None:
        self._mask_shape = mask.shape
        # by the number of neighbours, so that all pixels with as many are filled in at once
        pixels: dict[int, list[int]] = {}
        neighbours: dict[int, list[NDArray[np.intp]]] = {}
        for pixel in map(tuple, np.argwhere(mask)):
            view, (y, x) = pixel[:-2], pixel[-2:]
            rows, columns = _nearest_valid(mask[view], y, x)
            at = (*(np.full(len(rows), part) for part in view), rows, columns)
            pixels.setdefault(len(rows), []).append(int(np.ravel_multi_index(pixel, mask.shape)))
            neighbours.setdefault(len(rows), []).append(np.ravel_multi_index(at, mask.shape))
        self._windows = [
            (np.array(pixels[count]), np.array(neighbours[count])) for count in sorted(pixels)
        ]

    def __call__(self, radiance: Float, variance: Float) -> tuple[Float, Float]:
        """Fill in images (..., *camera_shape, C); see `repair`."""
        shape = self._mask_shape
        if radiance.ndim <= len(shape) or radiance.shape[-len(shape) - 1 : -1] != shape:
            raise InputError(f"a defect mask {shape} doesn't fit images {radiance.shape}")
        if not self._windows:
            return radiance, variance
        flat = (*radiance.shape[: -len(shape) - 1], prod(shape), radiance.shape[-1])
        images, spread = radiance.copy(), variance.copy()
        for pixels, neighbours in self._windows:
            values = radiance.reshape(flat)[..., neighbours, :]
            images.reshape(flat)[..., pixels, :] = np.median(values, axis=-2)
            noise = variance.reshape(flat)[..., neighbours, :].max(axis=-2)
            noise += values.var(axis=-2, dtype=np.float64)
            spread.reshape(flat)[..., pixels, :] = noise
        return images, spread


def _nearest_valid(mask: Mask, y: int, x: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the valid pixels in the smallest square around (y, x) that holds three, or any."""
    wanted = min(3, int(np.count_nonzero(~mask)))
    if wanted == 0:
        raise CaptureError("every pixel of a view is defective; check the camera and its exposures")
    radius = 0
    while True:
        radius += 1
        top, left = max(0, y - radius), max(0, x - radius)
        rows, columns = np.nonzero(~mask[top : y + radius + 1, left : x + radius + 1])
        if len(rows) >= wanted:
            return rows + top, columns + left


def _rounding(dtype: np.dtype[Any], floodlit_frames: NDArray[Any]) -> float:
    """Return a frame's rounding as standard deviation: of counts, or of float32 at full scale."""
    if dtype.kind == "u":
        return float(1 / np.sqrt(12))
    largest = float(np.abs(floodlit_frames).max(initial=0))
    return float(np.finfo(np.float32).eps) * largest


def _threshold(size: int) -> float:
    """Deviations that none of `size` good Gaussian pixels exceeds."""
    return SIGNIFICANCE + float(np.sqrt(2 * np.log(max(size, 2))))


def _robust(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return median and robust standard deviation."""
    centre = float(np.median(values))
    return centre, MAD_TO_DEVIATION * float(np.median(np.abs(values - centre)))


def _noisy(variance: NDArray[np.float64], freedom: int, floor: float) -> Mask:
    """Find pixels whose variance, of so many degrees of freedom, is an outlier.

    The cube root of a chi-squared variable is close to Gaussian (Wilson and Hilferty 1931).
    """
    spread = 2 / (9 * freedom)
    # the median of a chi-squared variable over its mean
    typical = max(float(np.median(variance)) / (1 - spread) ** 3, floor**2)
    if typical == 0:
        return np.asarray(variance > 0)
    score = (np.cbrt(variance / typical) - (1 - spread)) / np.sqrt(spread)
    outlying: Mask = score > _threshold(variance.size)
    return outlying


def _alone(responds: Mask, step: int) -> Mask:
    """Find pixels (*camera_shape, C) all of whose neighbours respond, or all but one.

    Neighbours are `step` pixels apart; at least two must exist.
    """
    pad = [(0, 0)] * (responds.ndim - 3) + [(step, step), (step, step), (0, 0)]
    there = np.pad(np.ones(responds.shape, np.int8), pad)
    padded = np.pad(responds.astype(np.int8), pad)
    height, width = responds.shape[-3:-1]
    responding = np.zeros(responds.shape, np.int8)
    existing = np.zeros(responds.shape, np.int8)
    for dy in (0, step, 2 * step):
        for dx in (0, step, 2 * step):
            if (dy, dx) != (step, step):
                window = (..., slice(dy, dy + height), slice(dx, dx + width), slice(None))
                responding += padded[window]
                existing += there[window]
    return np.asarray((existing >= 2) & (responding >= np.maximum(existing - 1, 2)))


def _grown(mask: Mask) -> Mask:
    """Grow a mask by one pixel in each direction of the image, the reach of the demosaic."""
    grown = mask.copy()
    for axis in (-2, -1):
        step = grown.copy()
        ahead = np.moveaxis(step, axis, 0)
        source = np.moveaxis(grown, axis, 0)
        ahead[1:] |= source[:-1]
        ahead[:-1] |= source[1:]
        grown = step
    return grown
