"""Random patterns of footprint acquisition."""

from __future__ import annotations

import numpy as np

from rfpipe.array_types import Bools
from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator
from rfpipe.relighting import octave_noise

SEED = 2026

# Powers of the frequency with which amplitudes fall, in turn. Noise of power 0 (white noise)
# distinguishes footprints, smooth noise determines far-range light.
_FALLOFFS = (2.0, 0.0, 1.0)


def view_patterns(shape: tuple[int, ...], key: int, count: int) -> Bools:
    """Draw binary noise of three kinds of detail in turn; each pattern lights half of one view.

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain. Several views are lit in turn, and round 1 of several views
        begins with one floodlit pattern per view.
    key : int
        Number of the round, from 1. A pattern depends on `key` and on its index in the round.
    count : int
        Number of patterns, floodlit ones included.

    Returns
    -------
    ndarray of bool, shape (count, *shape)
    """
    domain = RayDomain(shape)
    views = domain.views
    patterns = np.zeros((count, *domain.stack_shape), np.bool_)
    floodlit_count = views if views > 1 and key == 1 else 0
    for index in range(count):
        if index < floodlit_count:
            patterns[index, index % views] = True
            continue
        falloff = _FALLOFFS[index // views % len(_FALLOFFS)]
        field = octave_noise(domain.image_shape, generator(SEED, key, index), falloff)
        patterns[index, index % views] = field > np.median(field)
    return patterns.reshape(count, *shape)
