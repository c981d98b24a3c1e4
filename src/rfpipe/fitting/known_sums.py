"""Combinations of pictures that patterns determine beforehand, and the faults that they show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from rfpipe.array_types import Double, Float

LIT = 0.2
"""Share of the brightest pixels' light from which pixels count."""

BRIGHTEST = 99
"""Percentile of light that defines the brightest pixels."""

_NULL = 1e-6  # eigenvalues of P P^T up to this share of the largest are 0


@dataclass(frozen=True)
class PictureFault:
    """A fault of a set of pictures.

    Attributes
    ----------
    kind : {"exchanged", "unknown codes", "motion", "flicker"}
        Exchanged pictures and codes that the patterns don't have make a fit worthless; motion and
        flicker make it worse.
    pictures : tuple of int
        Indices, from 0, of the pictures concerned.
    message : str
        What is wrong, by how much, and what to do.
    """

    kind: Literal["exchanged", "unknown codes", "motion", "flicker"]
    pictures: tuple[int, ...]
    message: str


@dataclass(frozen=True)
class KnownSums:
    """Combinations of pictures that are known beforehand.

    Attributes
    ----------
    null : ndarray of float64, shape (K, K)
        The projector B onto the left null space of ``[P, 1]``.
    pairs : tuple of (int, int)
        Pictures and their complements, whose patterns add up to white.
    white : tuple of int
        Pictures of white patterns.
    """

    null: Double
    pairs: tuple[tuple[int, int], ...]
    white: tuple[int, ...]

    @classmethod
    def of(cls, patterns: Float) -> KnownSums:
        """Find the combinations that patterns (K, N) have."""
        gram = np.asarray(patterns @ patterns.T, np.float64) / patterns.shape[1]
        mean = patterns.mean(axis=1, dtype=np.float64)
        values, vectors = np.linalg.eigh(gram + 1)
        basis = vectors[:, values <= _NULL * values[-1]]
        covariance = gram - np.outer(mean, mean)
        variance = np.diag(covariance)
        is_even = variance < 1e-4
        scatter = variance[:, None] + variance + 2 * covariance  # of the sum of two patterns
        opposite = (scatter < 1e-4) & (np.abs(mean[:, None] + mean - 1) < 1e-2)
        opposite &= ~is_even[:, None] & ~is_even
        pairs: list[tuple[int, int]] = []
        free = set(range(len(mean)))
        for first, second in sorted(np.argwhere(np.triu(opposite)).tolist(), key=_distance):
            if {first, second} <= free:
                pairs.append((first, second))
                free -= {first, second}
        white = np.flatnonzero(is_even & (mean > 0.99)).tolist()
        return cls(basis @ basis.T, tuple(sorted(pairs)), tuple(white))


def _distance(pair: list[int]) -> int:
    """Return the distance of two pictures in their order."""
    return pair[1] - pair[0]
