"""Patterns of the held-out pictures, which no fit uses and which estimate the error.

They are of the kinds that people relight (`rfpipe.relighting`): shapes, bars and spots. Several
bars or spots are the *parts* of one pattern, so that one picture tests many of them.
`rfpipe.methods.error_estimate` computes the error of each part from the common picture.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rfpipe.array_types import Bools
from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator
from rfpipe.relighting import position_along, shapes, spot_place

HELD_OUT = ("shapes", "bars", "spots", "shapes", "bars", "spots")
"""Kinds of the held-out pictures. Both pictures of shapes have one pattern: their difference is
noise."""

HELD_OUT_OF_PRIOR = 3
"""Number of held-out pictures, one of each kind, that are taken first to judge a prior."""

REPEATED = [0, 3]
"""Indices of the pictures of one pattern, those of shapes."""

_SEED = 2010
_KEYS = (1, 2, 3, 1, 4, 5)  # of the random parts of each picture
_BARS = 5  # at most, in one pattern
_SPOTS = 20  # at most, in one pattern
# Largest share of the rays that the bars or spots of a pattern light; small images have fewer.
_MOST_LIT = 0.5
_SHAPES_LIT = 0.3  # share of the rays that shapes light
_CANDIDATES = 20  # random places of a spot, of which the one farthest from all other spots is used


@lru_cache(maxsize=8)
def held_out_parts(shape: tuple[int, ...]) -> tuple[Bools, ...]:
    """Draw the patterns of the held-out pictures, part by part.

    Parallel bars, and spots, are parts of one pattern; shapes are a single part. Of several views,
    the last bars light one, and each of the last spots one.

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain.

    Returns
    -------
    tuple of ndarray of bool, shape (parts, N)
        One for each of `HELD_OUT`.
    """
    domain, patterns = RayDomain(shape), []
    image = domain.image_shape
    for index, (kind, key) in enumerate(zip(HELD_OUT, _KEYS, strict=True)):
        random = generator(_SEED, key)
        if kind == "shapes":
            parts = shapes(image, random, _SHAPES_LIT)[None]
        elif kind == "bars":
            # the second bars are perpendicular to the first
            parts = _bars(image, random, (0.15 + key / 4) * np.pi)
        else:
            parts = _spots(image, random)
        views = np.ones((len(parts), domain.views, 1, 1), np.bool_)
        if index >= len(HELD_OUT) - 2:
            lit = random.integers(domain.views, size=len(parts) if kind == "spots" else 1)
            views = (np.arange(domain.views) == lit[:, None])[..., None, None]
        patterns.append((parts[:, None] & views).reshape(len(parts), -1))
    return tuple(patterns)


def held_out_patterns(shape: tuple[int, ...]) -> Bools:
    """Return the patterns of the held-out pictures, bool (pictures, *shape)."""
    patterns = [parts.any(axis=0) for parts in held_out_parts(tuple(shape))]
    return np.stack(patterns).reshape(-1, *shape)


def _bars(shape: tuple[int, int], random: np.random.Generator, angle: float) -> Bools:
    """Draw parallel bars of increasing width, bool (bars, H, W).

    The first is two pixels wide, the last a fifth of the image. They represent half planes too,
    whose errors are about as large, but half of the error of a single half plane is chance.
    """
    position = position_along(shape, angle)
    extent = np.ptp(position)
    widths = np.geomspace(2, max(2.0, min(shape) / 5), _BARS)
    while len(widths) > 1 and widths.sum() > _MOST_LIT * (extent + 1):
        widths = np.geomspace(2, widths[-1], len(widths) - 1)
    gap = max(extent - widths.sum(), 0) / len(widths)
    offsets = np.cumsum(widths + gap) - widths - gap
    starts = position.min() + gap * random.uniform(0.1, 0.9) + offsets
    ends = starts + widths
    bars = [(position >= start) & (position < end) for start, end in zip(starts, ends, strict=True)]
    # a bar in the corner of an image may contain no pixel
    visible = [bar for bar in bars if bar.any()]
    return np.stack(visible or [position == position.min()])


def _spots(shape: tuple[int, int], random: np.random.Generator) -> Bools:
    """Draw spots of all sizes, each far from those before it, bool (spots, H, W)."""
    spots: list[Bools] = []
    centres, is_lit = np.empty((0, 2)), np.zeros(shape, np.bool_)
    for size in (random.permutation(_SPOTS) + random.random(_SPOTS)) / _SPOTS:
        candidates = [spot_place(shape, random, size) for _ in range(_CANDIDATES)]
        middles = np.array(
            [[(part.start + part.stop - 1) / 2 for part in place] for place in candidates]
        )
        distances = np.linalg.norm(middles[:, None] - centres, axis=-1)
        best = int(np.argmax(distances.min(axis=1, initial=np.inf)))
        added = np.zeros(shape, np.bool_)
        # on tiny images, spots would overlap
        added[candidates[best]] = ~is_lit[candidates[best]]
        if spots and is_lit.sum() + added.sum() > _MOST_LIT * added.size:
            break
        if added.any():
            spots.append(added)
            is_lit |= added
        centres = np.concatenate([centres, middles[best : best + 1]])
    return np.stack(spots)
