"""Late frames, which show the previous picture or the previous exposure.

A bracket F is late where, for one of its exposures e,

    min over i |F[e] - P[i]| < c min over i |F[e] - R[i]|,    or    sum F[e + 1] < s sum F[e]

====== ======== ====== =======================================================================
symbol code     shape  meaning
====== ======== ====== =======================================================================
F      frames   (E, n) counts of n camera pixels; light above black in the sum
P      previous (E, n) reference of the picture that was shown before, in all exposures
R      expected (E, n) reference of the picture that is shown
c      _CLOSER  ()     ratio of distances, 0 of a late frame without noise
s      ratio    ()     ratio that flicker or gain can't explain
====== ======== ====== =======================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double

_CLOSER = 0.5


def is_of_previous(frames: NDArray[Any], previous: Double, expected: Double) -> bool:
    """Test whether a frame of a bracket agrees better with the previous than the expected picture.

    Parameters
    ----------
    frames : ndarray, shape (E, n)
    previous, expected : ndarray of float64, shape (E, n)
        Reference brackets of the two pictures.
    """
    return any(
        _distance(frame, previous) < _CLOSER * _distance(frame, expected) for frame in frames
    )


def is_out_of_order(light: Sequence[float], ratio: float, least: float = 0.0) -> bool:
    """Test whether a longer exposure is darker than `ratio` times the next shorter one.

    Parameters
    ----------
    light : sequence of E floats
        Sum or mean above black of each exposure, for ascending exposures.
    ratio : float
    least : float
        Light above which the shorter exposure is more than noise.
    """
    return any(shorter > least and longer < ratio * shorter for shorter, longer in pairwise(light))


def _distance(frame: NDArray[Any], references: Double) -> float:
    """RMS distance of a frame (n,) from the nearest of references (E, n)."""
    return float(np.sqrt(np.square(frame - references).mean(axis=1).min()))
