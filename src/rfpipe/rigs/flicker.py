"""Distinction of flicker of the lamp from changes of gain, by the exposures of each bracket.

Light in exposure e + 1 over that in exposure e, of a bracket with counts F and black B:

    q[e] = (F[e + 1] - B[e + 1]) / t[e + 1] * t[e] / (F[e] - B[e])

====== =========== ====== ======================================================================
symbol code        shape  meaning
====== =========== ====== ======================================================================
F      frames      (E, n) counts of n camera pixels
B      black       (E, n) counts without light
t      exposures   (E,)   seconds, ascending
q      ratio       (E-1,) 1 of a steady lamp and a linear camera, of sums over pixels
====== =========== ====== ======================================================================

The gain of a bracket is common to its exposures, and q stays 1. Flicker is random in each exposure,
changes q, and vanishes in exposures of whole periods and in long ones. A gain that changes within
brackets changes q of long exposures, too. No reference picture is needed, and the pattern may
change from bracket to bracket.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.rigs.faults import Fault, flicker_fault, gain_fault, is_whole_period, unsteady_fault

_LEAST_PIXELS = 50
_HEADROOM = 0.8  # counts over saturation: a brighter bracket does not saturate either
_AVERAGED_SECONDS = 0.1  # longer exposures average flicker at mains frequency
_COMMON = 0.3  # spread of q, relative to the spread of gains, above which brackets flicker


def exposure_ratios(
    frames: NDArray[np.floating], black: Double, exposures: Sequence[float], saturated: float
) -> Double:
    """Compute the ratios q of a bracket (E, n), and their standard errors.

    A ratio uses the pixels that its longer exposure doesn't saturate.

    Returns
    -------
    ndarray of float64, shape (2, E - 1)
        NaN where too few pixels are known.
    """
    seconds = np.array(exposures)[:, None]
    rate = (frames - black) / seconds
    ratios = np.full((2, len(seconds) - 1), np.nan)
    for index in range(len(seconds) - 1):
        usable = frames[index + 1] < _HEADROOM * saturated
        light = rate[index, usable].mean() if usable.sum() >= _LEAST_PIXELS else 0.0
        if light > 0:
            change = (rate[index + 1] - rate[index])[usable]
            ratios[0, index] = 1 + change.mean() / light
            ratios[1, index] = change.std() / np.sqrt(change.size) / light
    return ratios


def flicker_of(
    ratio: Double,
    error: Double,
    exposures: Sequence[float],
    spread: Callable[[Double], float],
    significance: float,
) -> float | None:
    """Estimate the spread of the ratios if flicker can have caused it, else 0.

    Parameters
    ----------
    ratio, error : ndarray of float64, shape (K, E - 1)
        Ratios of K brackets and their standard errors; NaN where unknown.
    exposures : sequence of E floats
    spread : callable
        Spread of the known values (k,) of one ratio.
    significance : float
        Multiple of its error above which a spread is more than noise.

    Returns
    -------
    float or None
        None where no ratio is known of two brackets.
    """
    known = np.isfinite(ratio).sum(axis=0) > 1
    if not known.any():
        return None
    error = np.nanmax(error[:, known], axis=0)
    spreads = np.array([spread(column[np.isfinite(column)]) for column in ratio[:, known].T])
    spreads = np.where(spreads > significance * error, spreads, 0)
    are_long = np.array(exposures[:-1])[known] >= _AVERAGED_SECONDS
    largest = float(spreads.max())
    return largest if float(spreads[are_long].max(initial=0)) < largest / 3 else 0.0


def gain_or_flicker(size: float, flicker: float | None, exposures: Sequence[float]) -> Fault:
    """Decide whether gain or flicker changes the light by `size`, given `flicker_of` the ratios."""
    if flicker is None:
        is_averaged = all(map(is_whole_period, exposures))
        return gain_fault(size) if is_averaged else unsteady_fault(size)
    return flicker_fault(size, exposures) if flicker > _COMMON * size else gain_fault(size)
