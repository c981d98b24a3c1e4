"""The patterns of near/far acquisition: random, half lit, with detail of every size.

White noise holds too little of the large shapes that far-range light depends on, smooth noise too
little of the small ones: here every octave of size has the same power. Once the range of indirect
light is known, bands of about equal range are lit together, too, since pictures of random detail
say little of long thin shapes along a crease.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.near_far.transport import LightRange
from rfpipe.provenance import generator

__all__ = ["held_out_strip_twice", "held_out_twice", "probe_patterns"]

_SEED = 2006
# How strong the bands are beside the noise, in its standard deviations, and how many octaves of
# range a band and its dark neighbour take together.
_BANDS = 1.5
_OCTAVES = (2.0, 10.0)
# One probe in so many is a strip; parts of the image that strips light.
_STRIPS = 4
_NARROWEST, _WIDEST = 0.01, 0.3
# Parts of the image that held-out patterns light.
_HELD_OUT, _HELD_OUT_STRIP = 0.3, 1 / 32


def probe_patterns(
    shape: tuple[int, ...], level: int, count: int, found: LightRange | None = None
) -> NDArray[np.bool_]:
    """Return random patterns, bool (count, *shape).

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    level : int
        Of the acquisition: another level has other patterns.
    count : int
    found : LightRange, optional
        Where indirect light comes from; None where it is not known yet.
    """
    patterns = np.zeros((count, *shape), np.bool_)
    for index in range(count):
        random = generator(_SEED, level, index)
        field = _noise(shape, random)
        if found is not None:
            octaves = 1 / random.uniform(1 / _OCTAVES[1], 1 / _OCTAVES[0])
            phase = random.uniform(0, 1)
            angle = random.uniform(0, 2 * np.pi)
            side = np.cos(angle) * found.across + np.sin(angle) * found.down > 0
            bands = np.log2(found.reach) / octaves + phase + side / 2
            field += _BANDS * np.cos(2 * np.pi * bands)
        patterns[index] = field > np.median(field)
        if found is not None and index % _STRIPS == 0:
            part = np.exp(random.uniform(np.log(_NARROWEST), np.log(_WIDEST)))
            patterns[index] = _brightest(found.nearness, part) & side
    return patterns


def held_out_twice(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a pattern of random shapes, twice, bool (2, *shape)."""
    lit = _brightest(_noise(shape, generator(_SEED, 0, 0)), _HELD_OUT)
    return np.stack([lit, lit])


def held_out_strip_twice(found: LightRange) -> NDArray[np.bool_]:
    """Return the strip where most light stays near, twice, bool (2, *shape)."""
    lit = _brightest(found.nearness, _HELD_OUT_STRIP)
    return np.stack([lit, lit])


def _brightest(image: NDArray[np.floating[Any]], part: float) -> NDArray[np.bool_]:
    """Return the part of an image that is brightest; of equal pixels, the first."""
    count = max(1, round(part * image.size))
    chosen = np.zeros(image.size, np.bool_)
    chosen[np.argsort(-image.ravel(), kind="stable")[:count]] = True
    return chosen.reshape(image.shape)


def _noise(shape: tuple[int, ...], random: np.random.Generator) -> NDArray[np.float64]:
    """Return noise of equal power in every octave, with unit deviation, on the torus."""
    height, width = RayDomain(shape).image_shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    amplitude = 1 / np.maximum(frequency, 1 / max(height, width))
    amplitude[0, 0] = 0
    white = np.fft.rfft2(random.standard_normal(shape))
    field = np.fft.irfft2(white * amplitude, s=(height, width), axes=(-2, -1))
    spread = field.std()
    # a single ray has no detail
    noise: NDArray[np.float64] = field / spread if spread > 0 else random.standard_normal(shape)
    return noise
