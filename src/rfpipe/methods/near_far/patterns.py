"""The patterns of near/far acquisition: random, half lit, with detail of every size.

White noise holds too little of the large shapes that far-range light depends on, smooth noise too
little of the small ones: here every octave of size has the same power. Once the range of indirect
light is known, bands of about equal range are lit together, too, since pictures of random detail
say little of long thin shapes along a crease.

What smooth functions leave is looked for with random blocks, of one size a pattern.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.held_out.patterns import SEED, brightest, octave_noise
from rfpipe.methods.near_far.transport import LightRange
from rfpipe.provenance import generator
from rfpipe.transport.wavelet.cells import Cells

__all__ = ["block_patterns", "probe_patterns"]

# How strong the bands are beside the noise, in its standard deviations, and how many octaves of
# range a band and its dark neighbour take together.
_BANDS = 1.5
_OCTAVES = (2.0, 10.0)
# One probe in so many is a strip; parts of the image that strips light.
_STRIPS = 4
_NARROWEST, _WIDEST = 0.01, 0.3
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
        random = generator(SEED, level, index)
        field = octave_noise(shape, random)
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
            patterns[index] = brightest(found.nearness, part) & side
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
        random = generator(SEED, level, index)
        side = _BLOCKS[index % len(_BLOCKS)]
        down, across = random.integers(0, side, 2)
        grid = (views, height // side + 2, width // side + 2)
        lit = (random.random(grid) < _BLOCKS_LIT).repeat(side, axis=1).repeat(side, axis=2)
        cut = lit[:, down : down + height, across : across + width]
        patterns[index] = cut.reshape(-1)[cells.of_ray].reshape(cells.shape)
    return patterns
