"""Random patterns of footprint acquisition."""

from __future__ import annotations

import numpy as np

from rfpipe.array_types import Bools
from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator
from rfpipe.relighting import octave_noise

SEED = 2026

# Powers of the frequency with which amplitudes fall, in turn: white noise distinguishes footprints,
# smooth noise determines far-range light.
_FALLOFFS = (2.0, 0.0, 1.0)


def view_patterns(shape: tuple[int, ...], key: int, count: int) -> Bools:
    """Draw noise of three kinds of detail in turn that lights half of a view.

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain. Several views are lit one at a time, in turn; in round 1 first
        each as a whole.
    key : int
        Number of the round: each has other patterns. A pattern depends on `key` and its index.
    count : int

    Returns
    -------
    ndarray of bool, shape (count, *shape)
    """
    domain = RayDomain(shape)
    views = domain.views
    patterns = np.zeros((count, *domain.stack_shape), np.bool_)
    white = views if views > 1 and key == 1 else 0
    for index in range(count):
        if index < white:
            patterns[index, index % views] = True
            continue
        falloff = _FALLOFFS[index // views % len(_FALLOFFS)]
        field = octave_noise(domain.image_shape, generator(SEED, key, index), falloff)
        patterns[index, index % views] = field > np.median(field)
    return patterns.reshape(count, *shape)
