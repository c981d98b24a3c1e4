"""Random patterns that models are fitted to.

White noise holds too little of the large shapes that far-range light depends on, smooth noise too
little of the small ones; noise with equal power in every octave of size lies between.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator
from rfpipe.relighting import brightest, octave_noise
from rfpipe.transport.wavelet import Cells

if TYPE_CHECKING:
    from rfpipe.methods.adaptive.smooth import LightRange

SEED = 2006
"""Of all random patterns but those of footprints."""

_SEED_OF_FOOTPRINTS = 2026

Bools = NDArray[np.bool_]


def probe_patterns(
    shape: tuple[int, ...], level: int, count: int, found: LightRange | None = None
) -> Bools:
    """Return half-lit octave noise, bool (count, *shape), another at each level.

    Where the range of indirect light is known, bands of about equal range are lit together, too,
    and one pattern in four is a strip: random detail says little of long thin shapes along a
    crease.
    """
    patterns = np.zeros((count, *shape), np.bool_)
    for index in range(count):
        random = generator(SEED, level, index)
        field = octave_noise(shape, random)
        if found is not None:
            # a band and its dark neighbour take together two to ten octaves of range
            octaves = 1 / random.uniform(1 / 10.0, 1 / 2.0)
            phase = random.uniform(0, 1)
            angle = random.uniform(0, 2 * np.pi)
            side = np.cos(angle) * found.across + np.sin(angle) * found.down > 0
            bands = np.log2(found.reach) / octaves + phase + side / 2
            field += 1.5 * np.cos(2 * np.pi * bands)
        patterns[index] = field > np.median(field)
        if found is not None and index % 4 == 0:
            part = np.exp(random.uniform(np.log(0.01), np.log(0.3)))
            patterns[index] = brightest(found.nearness, part) & side
    return patterns


def block_patterns(cells: Cells, level: int, count: int) -> Bools:
    """Return random blocks of cells, of one size a pattern, bool (count, *shape)."""
    views, height, width = cells.stack
    patterns = np.zeros((count, *cells.shape), np.bool_)
    for index in range(count):
        random = generator(SEED, level, index)
        side = 2 ** (index % 4)
        down, across = random.integers(0, side, 2)
        grid = (views, height // side + 2, width // side + 2)
        # three tenths lit; at 48 x 48, a tenth does as well
        lit = (random.random(grid) < 0.3).repeat(side, axis=1).repeat(side, axis=2)
        cut = lit[:, down : down + height, across : across + width]
        patterns[index] = cut.reshape(-1)[cells.of_ray].reshape(cells.shape)
    return patterns


def view_patterns(shape: tuple[int, ...], level: int, count: int) -> Bools:
    """Return half-lit noise of three kinds of detail in turn, bool (count, *shape).

    White noise tells footprints apart; noise that falls with the frequency squared is what
    far-range light depends on. Several views are lit one at a time, in turn, and at level 1 first
    all of each.
    """
    domain = RayDomain(shape)
    views = domain.views
    patterns = np.zeros((count, *domain.stack_shape), np.bool_)
    whole = views if views > 1 and level == 1 else 0
    for index in range(count):
        if index < whole:
            patterns[index, index % views] = True
            continue
        falloff = (2.0, 0.0, 1.0)[index // views % 3]
        field = octave_noise(
            domain.image_shape, generator(_SEED_OF_FOOTPRINTS, level, index), falloff
        )
        patterns[index, index % views] = field > np.median(field)
    return patterns.reshape(count, *shape)
