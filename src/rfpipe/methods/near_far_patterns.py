"""The patterns of near/far acquisition: random, half lit, with detail of every size.

White noise holds too little of the large shapes that far-range light depends on, smooth noise too
little of the small ones: here every octave of size has the same power. Once the range of indirect
light is known, bands of about equal range are lit together, too, since pictures of random detail
say little of long thin shapes along a crease.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.provenance import generator

__all__ = ["HELD_OUT", "held_out_patterns", "probe_patterns"]

_SEED = 2006
# How strong the bands are beside the noise, in its standard deviations, and how many octaves of
# range a band and its dark neighbour take together.
_BANDS = 1.5
_OCTAVES = (2.0, 10.0)
# Each held-out pattern is shown twice: the product of two errors has no noise on average.
HELD_OUT = 4
_HELD_OUT_LIT = (0.5, 0.15)


def probe_patterns(
    shape: tuple[int, ...], level: int, count: int, reach: Float | None
) -> NDArray[np.bool_]:
    """Return random patterns, half lit, bool (count, *shape).

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    level : int
        Of the acquisition: another level has other patterns.
    count : int
    reach : ndarray of float32, shape `shape`, optional
        Range of each pixel's indirect light, in pixels, above 0; None where it is not known yet.
    """
    patterns = np.zeros((count, *shape), np.bool_)
    for index in range(count):
        random = generator(_SEED, level, index)
        field = _noise(shape, random)
        if reach is not None:
            octaves = 1 / random.uniform(1 / _OCTAVES[1], 1 / _OCTAVES[0])
            phase = random.uniform(0, 1)
            field += _BANDS * np.cos(2 * np.pi * (np.log2(reach) / octaves + phase))
        patterns[index] = field > np.median(field)
    return patterns


def held_out_patterns(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the patterns that no fit sees, each twice in a row, bool (HELD_OUT, *shape)."""
    patterns = []
    for index, lit in enumerate(_HELD_OUT_LIT):
        field = _noise(shape, generator(_SEED, 0, index))
        patterns += [field > np.quantile(field, 1 - lit)] * 2
    return np.array(patterns)


def _noise(shape: tuple[int, ...], random: np.random.Generator) -> NDArray[np.float64]:
    """Return noise of equal power in every octave, with unit deviation, on the torus."""
    height, width = shape[-2:]
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    amplitude = 1 / np.maximum(frequency, 1 / max(height, width))
    amplitude[0, 0] = 0
    white = np.fft.rfft2(random.standard_normal(shape))
    field = np.fft.irfft2(white * amplitude, s=(height, width), axes=(-2, -1))
    spread = field.std()
    # a single ray has no detail
    noise: NDArray[np.float64] = field / spread if spread > 0 else random.standard_normal(shape)
    return noise
