"""The random patterns of footprint acquisition: half lit, of three kinds of detail in turn.

White noise tells footprints apart; noise that falls with the frequency squared is what far-range
light depends on; equal power in each octave lies between. Coarser than near/far acquisition's: here
indirect light is looked for in all pixels, beside what a footprint shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.held_out.patterns import octave_noise
from rfpipe.provenance import generator

__all__ = ["random_patterns"]

_SEED = 2026
_FALLOFFS = (2.0, 0.0, 1.0)


def random_patterns(shape: tuple[int, ...], level: int, count: int) -> NDArray[np.bool_]:
    """Return random patterns, bool (count, *shape).

    Several views are lit one at a time, in turn, and at the first level first all of each.

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain.
    level : int
        Of the acquisition: another level has other patterns.
    count : int
    """
    domain = RayDomain(shape)
    views, image = domain.views, domain.image_shape
    patterns = np.zeros((count, *domain.stack_shape), np.bool_)
    whole = views if views > 1 and level == 1 else 0
    for index in range(count):
        view = index % views
        if index < whole:
            patterns[index, view] = True
            continue
        random = generator(_SEED, level, index)
        field = octave_noise(image, random, _FALLOFFS[index // views % len(_FALLOFFS)])
        patterns[index, view] = field > np.median(field)
    return patterns.reshape(count, *shape)
