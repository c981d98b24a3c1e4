"""The patterns of held-out pictures: random shapes, a strip where light stays near, small spots."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator

__all__ = [
    "HELD_OUT",
    "MOST_HELD_OUT",
    "SEED",
    "brightest",
    "held_out_shapes",
    "held_out_spots",
    "held_out_strip",
    "octave_noise",
]

HELD_OUT = 2
"""Pictures of each held-out pattern."""

MOST_HELD_OUT = 3 * HELD_OUT
"""Held-out pictures of an acquisition: of shapes, the strip and spots."""

SEED = 2006
"""Of all random patterns."""

# Parts of the image that held-out patterns light.
_SHAPES, _STRIP = 0.3, 1 / 32
# Small spots in each view: how many, and their sides, from two pixels to this part of the image's.
_SPOTS, _LARGEST_SPOT = 8, 1 / 12


def held_out_shapes(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a pattern of random shapes, bool (*shape)."""
    return brightest(octave_noise(shape, generator(SEED, 0, 0)), _SHAPES)


def held_out_strip(nearness: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return the strip where most light stays near, by how much does (*shape): bool (*shape)."""
    return brightest(nearness, _STRIP)


def held_out_spots(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a few small spots in each view, bool (*shape)."""
    views, height, width = RayDomain(shape).stack_shape
    spots, random = np.zeros((views, height, width), np.bool_), generator(SEED, 0, 1)
    most = max(2.0, _LARGEST_SPOT * min(height, width))
    for view, _ in product(range(views), range(_SPOTS)):
        side = min(round(np.exp(random.uniform(np.log(2), np.log(most)))), height, width)
        top, left = random.integers(0, height - side + 1), random.integers(0, width - side + 1)
        spots[view, top : top + side, left : left + side] = True
    return spots.reshape(shape)


def brightest(image: NDArray[np.floating[Any]], part: float) -> NDArray[np.bool_]:
    """Return the part of an image that is brightest; of equal pixels, the first."""
    count = max(1, round(part * image.size))
    chosen = np.zeros(image.size, np.bool_)
    chosen[np.argsort(-image.ravel(), kind="stable")[:count]] = True
    return chosen.reshape(image.shape)


def octave_noise(
    shape: tuple[int, ...], random: np.random.Generator, falloff: float = 1.0
) -> NDArray[np.float64]:
    """Return noise with unit deviation, on the torus, float64 (*shape).

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    random : Generator
    falloff : float
        The power of the frequency with which amplitudes fall: 1 has equal power in every octave,
        0 is white.
    """
    height, width = RayDomain(shape).image_shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    amplitude = 1 / np.maximum(frequency, 1 / max(height, width)) ** falloff
    amplitude[0, 0] = 0
    white = np.fft.rfft2(random.standard_normal(shape))
    field = np.fft.irfft2(white * amplitude, s=(height, width), axes=(-2, -1))
    spread = field.std()
    # a single ray has no detail
    noise: NDArray[np.float64] = field / spread if spread > 0 else random.standard_normal(shape)
    return noise
