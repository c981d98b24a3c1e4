"""The random patterns of footprint acquisition: half lit, of three kinds of detail in turn.

White noise tells footprints apart; noise that falls with the frequency squared is what far-range
light depends on; equal power in each octave lies between. Coarser than near/far acquisition's: here
indirect light is looked for in all pixels, beside what a footprint shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.held_out.patterns import octave_noise
from rfpipe.provenance import generator

__all__ = ["random_patterns"]

_SEED = 2026
_FALLOFFS = (2.0, 0.0, 1.0)


def random_patterns(shape: tuple[int, ...], level: int, count: int) -> NDArray[np.bool_]:
    """Return random patterns, bool (count, *shape).

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain.
    level : int
        Of the acquisition: another level has other patterns.
    count : int
    """
    patterns = np.zeros((count, *shape), np.bool_)
    for index in range(count):
        random = generator(_SEED, level, index)
        field = octave_noise(shape, random, _FALLOFFS[index % len(_FALLOFFS)])
        patterns[index] = field > np.median(field)
    return patterns
