"""The patterns of near/far acquisition: random, half lit, with detail of every size.

White noise holds too little of the large shapes that far-range light depends on, smooth noise too
little of the small ones: here every octave of size has the same power. Once the range of indirect
light is known, bands of about equal range are lit together, too, since pictures of random detail
say little of long thin shapes along a crease.

What smooth functions leave is looked for with random blocks, of one size a pattern.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.near_far.transport import LightRange
from rfpipe.provenance import generator
from rfpipe.transport.wavelet.cells import Cells

__all__ = [
    "block_patterns",
    "held_out_shapes",
    "held_out_spots",
    "held_out_strip",
    "noise",
    "probe_patterns",
]

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
# Small spots in each view: how many, and their sides, from two pixels to this part of the image's.
_SPOTS, _LARGEST_SPOT = 8, 1 / 12
# Sides of blocks in cells, and the part of them that is lit: at 48 x 48, a tenth does as well.
_BLOCKS, _BLOCKS_LIT = (1, 2, 4, 8), 0.3


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
        field = noise(shape, random)
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


def block_patterns(cells: Cells, level: int, count: int) -> NDArray[np.bool_]:
    """Return patterns of random blocks of cells, bool (count, *shape).

    Parameters
    ----------
    cells : Cells
    level : int
        Of the acquisition: another level has other patterns.
    count : int
    """
    views, height, width = cells.stack
    patterns = np.zeros((count, *cells.shape), np.bool_)
    for index in range(count):
        random = generator(_SEED, level, index)
        side = _BLOCKS[index % len(_BLOCKS)]
        down, across = random.integers(0, side, 2)
        grid = (views, height // side + 2, width // side + 2)
        lit = (random.random(grid) < _BLOCKS_LIT).repeat(side, axis=1).repeat(side, axis=2)
        cut = lit[:, down : down + height, across : across + width]
        patterns[index] = cut.reshape(-1)[cells.of_ray].reshape(cells.shape)
    return patterns


def held_out_shapes(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a pattern of random shapes, bool (*shape)."""
    return _brightest(noise(shape, generator(_SEED, 0, 0)), _HELD_OUT)


def held_out_strip(nearness: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return the strip where most light stays near, bool (*shape), see `LightRange.nearness`."""
    return _brightest(nearness, _HELD_OUT_STRIP)


def held_out_spots(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a few small spots in each view, bool (*shape)."""
    views, height, width = RayDomain(shape).stack_shape
    spots, random = np.zeros((views, height, width), np.bool_), generator(_SEED, 0, 1)
    most = max(2.0, _LARGEST_SPOT * min(height, width))
    for view, _ in product(range(views), range(_SPOTS)):
        side = min(round(np.exp(random.uniform(np.log(2), np.log(most)))), height, width)
        top, left = random.integers(0, height - side + 1), random.integers(0, width - side + 1)
        spots[view, top : top + side, left : left + side] = True
    return spots.reshape(shape)


def _brightest(image: NDArray[np.floating[Any]], part: float) -> NDArray[np.bool_]:
    """Return the part of an image that is brightest; of equal pixels, the first."""
    count = max(1, round(part * image.size))
    chosen = np.zeros(image.size, np.bool_)
    chosen[np.argsort(-image.ravel(), kind="stable")[:count]] = True
    return chosen.reshape(image.shape)


def noise(
    shape: tuple[int, ...], random: np.random.Generator, falloff: float = 1.0
) -> NDArray[np.float64]:
    """Return noise with unit deviation, on the torus, float64 (*shape).

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    random : Generator
    falloff : float
        The power of the frequency with which amplitudes fall: 0 is white, 1 has equal power in
        every octave.
    """
    height, width = RayDomain(shape).image_shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    amplitude = 1 / np.maximum(frequency, 1 / max(height, width)) ** falloff
    amplitude[0, 0] = 0
    white = np.fft.rfft2(random.standard_normal(shape))
    field = np.fft.irfft2(white * amplitude, s=(height, width), axes=(-2, -1))
    spread = field.std()
    # a single ray has no detail
    found: NDArray[np.float64] = field / spread if spread > 0 else random.standard_normal(shape)
    return found
