"""What an acquisition shows first, and how a rig is told what it shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.keys import BLACK_LEVEL_KEY, FLOODLIT_KEY, SYMMETRY_KEY
from rfpipe.photometry.symmetry import random_signs

__all__ = ["Keys", "reference_patterns", "symmetry_patterns"]

Keys = list[tuple[int, ...]]
"""A key a pattern: for the rig's random numbers, and for messages."""


def reference_patterns(
    projector_shape: tuple[int, ...], black_frames: int, first: int, last: int
) -> tuple[NDArray[np.float32], Keys]:
    """Return some of the patterns that an acquisition begins with, and their keys for the rig.

    They are `black_frames` times all off, then all on: what the merge's
    `Merger.from_references` learns from.
    """
    indices = range(first, last)
    patterns = np.zeros((len(indices), *projector_shape), np.float32)
    patterns[max(0, black_frames - first) :] = 1
    keys: Keys = [
        (BLACK_LEVEL_KEY, index) if index < black_frames else (FLOODLIT_KEY, index - black_frames)
        for index in indices
    ]
    return patterns, keys


def symmetry_patterns(
    projector_shape: tuple[int, ...], count: int, first: int, last: int
) -> tuple[NDArray[np.float32], Keys]:
    """Return some of the `count` random patterns that tell whether a rig is coaxial, and keys."""
    lit = random_signs(projector_shape, 1, count, seed=0)[first:last] > 0
    return lit.astype(np.float32), [(SYMMETRY_KEY, index) for index in range(first, last)]
