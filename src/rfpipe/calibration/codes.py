"""Structured light: Gray code for where about, phase shift for where exactly, and how sharp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["AxisCode", "Decoded", "gray_bits", "gray_index"]

Float = NDArray[np.float32]
Double = NDArray[np.float64]

CELLS = 4
"""Cells of the Gray code a period: half a cell and one misread neighbour are still less than the
half period up to which the phase is unwrapped rightly."""

COARSER = 2
"""Period of the second sinusoids over that of the first: both contrasts together tell the blur."""

WEAK = 3.0
"""Deviations of noise below which a bit is not told from its inverse; one such bit a pixel, at an
edge between cells, is what Gray codes are made for."""


def gray_bits(index: NDArray[np.integer], bits: int) -> NDArray[np.bool_]:
    """Return the Gray code of indices (...), most significant bit first: (bits, ...)."""
    code = index ^ (index >> 1)
    return np.stack([(code >> bit & 1).astype(bool) for bit in reversed(range(bits))])


def gray_index(bits: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices (...) of Gray codes (bits, ...), most significant bit first."""
    binary = np.logical_xor.accumulate(bits, axis=0)
    return np.asarray(np.tensordot(1 << np.arange(len(bits))[::-1], binary, 1), np.int64)


@dataclass(frozen=True, eq=False)
class Decoded:
    """One coordinate of the projector, for each camera pixel (...).

    Attributes
    ----------
    coordinate : ndarray of float64
        From 0 to the axis' extent where valid.
    error : ndarray of float64
        Its standard error by the noise.
    modulation : ndarray of float64
        Amplitude of the sinusoids over its own standard error.
    contrast : ndarray of float64
        Amplitude of the sinusoids over that of those of twice the period: 1 less what is lost by
        blur and by the pixel's own extent. Indirect light is smooth, and has no share in either.
    valid : ndarray of bool
        Where the sinusoids rise above the noise of as many pixels, at most one bit is weak, and
        the coordinate lies on the projector.
    """

    coordinate: Double
    error: Double
    modulation: Double
    contrast: Double
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class AxisCode:
    """The pictures that tell one coordinate of the projector.

    A coordinate counts pixels from the picture's edge: a pixel's middle lies at a half.

    Parameters
    ----------
    extent : int
        Pixels along the axis.
    period : int
        Pixels of a sinusoid's period, a multiple of 4, at least 8.
    steps : int
        Sinusoids, 3 or more; with n of them, harmonics up to n - 2 don't bend the phase.
    """

    extent: int
    period: int = 16
    steps: int = 6

    def __post_init__(self) -> None:
        if self.period < 2 * CELLS or self.period % CELLS:
            raise InputError(
                f"a period of {self.period} pixels; expected a multiple of {CELLS}, at least "
                f"{2 * CELLS}"
            )
        if self.steps < 3:
            raise InputError(f"{self.steps} phase steps; expected 3 or more")

    @property
    def cell(self) -> int:
        """Pixels of a cell of the Gray code."""
        return self.period // CELLS

    @property
    def bits(self) -> int:
        """Bits of the Gray code."""
        return max(1, (-(-self.extent // self.cell) - 1).bit_length())

    @property
    def count(self) -> int:
        """Pictures."""
        return 2 * self.bits + 2 * self.steps

    def lines(self) -> Iterator[Float]:
        """Yield the weights along the axis of each picture: bits, each inverted, then sinusoids."""
        pixel = np.arange(self.extent)
        for bit in gray_bits(pixel // self.cell, self.bits):
            yield bit.astype(np.float32)
            yield (~bit).astype(np.float32)
        for period in (self.period, COARSER * self.period):
            phase = 2 * np.pi * (pixel + 0.5) / period
            for step in range(self.steps):
                wave = 0.5 + 0.5 * np.cos(phase - 2 * np.pi * step / self.steps)
                yield wave.astype(np.float32)

    def decode(self, images: Double, variance: Double) -> Decoded:
        """Find the coordinate that each camera pixel looks at.

        Parameters
        ----------
        images, variance : ndarray of float64, shape (count, ...)
            Radiance under each picture, and its variance.
        """
        split = 2 * self.bits
        bright, inverse = images[:split:2], images[1:split:2]
        spread = np.sqrt(variance[:split:2] + variance[1:split:2])
        weak = (np.abs(bright - inverse) <= WEAK * spread).sum(axis=0)
        coarse = (gray_index(bright > inverse) + 0.5) * self.cell
        sharp, smooth = images[split : split + self.steps], images[split + self.steps :]
        amplitude, phase = self._wave(sharp)
        noise = np.sqrt(variance[split:].mean(axis=0) * 2 / self.steps)
        fine = self.period * phase / (2 * np.pi)
        coordinate = fine + self.period * np.round((coarse - fine) / self.period)
        # an error of more than a period means nothing
        noisy = noise >= 2 * np.pi * amplitude
        ratio = np.divide(noise, amplitude, out=np.full(noise.shape, 2 * np.pi), where=~noisy)
        modulation = np.divide(amplitude, noise, out=np.full(noise.shape, np.inf), where=noise > 0)
        # noise alone gives amplitudes up to about sqrt(2 log n)
        least = WEAK + np.sqrt(2 * np.log(max(amplitude.size, 2)))
        seen = (modulation > least) & (amplitude > 0)
        on_projector = (coordinate >= 0) & (coordinate <= self.extent)
        full = self._wave(smooth)[0]
        contrast = np.divide(amplitude, full, out=np.zeros_like(full), where=full > WEAK * noise)
        return Decoded(
            coordinate,
            self.period / (2 * np.pi) * ratio,
            modulation,
            contrast,
            seen & (weak <= 1) & on_projector,
        )

    def _wave(self, images: Double) -> tuple[Double, Double]:
        """Return amplitude and phase of sinusoids shifted step by step, (steps, ...)."""
        angles = 2 * np.pi * np.arange(self.steps) / self.steps
        cosine, sine = (
            np.tensordot(wave(angles), images, 1) * 2 / self.steps for wave in (np.cos, np.sin)
        )
        return np.hypot(cosine, sine), np.arctan2(sine, cosine)
