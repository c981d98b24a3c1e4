"""Faults that looks at a rig show, by the quantities of `rfpipe.rigs.looks`.

With the references R_B, R_P and R_Q of black, a pattern and its complement, each look F gives

    F = R_B + x_P (R_P - R_B) + x_Q (R_Q - R_B) + a

======== ======== ===================================================================
symbol   shape    fault that changes it
======== ======== ===================================================================
R_B      (E, n)   room
g        (E,)     gain, flicker, drift; g is x_P - x_Q of a look at P
r        (E,)     motion; r is the residual of the equation
======== ======== ===================================================================

- Gain and lamp multiply: g changes. Light of the room adds: to `a` as haze, and to x_P and x_Q
  alike where the scene reflects it, since ``P + Q`` is a white picture. It does not change g, but
  it changes the looks at black.
- The gain of a bracket is common to its exposures. Flicker is not: see `rfpipe.rigs.flicker`.
- A lamp drifts slowly: adjacent looks agree, distant ones do not.
- Motion changes the picture's shape: r rises.
- Late frames agree with the reference of the look before.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs.faults import (
    SIGNIFICANCE,
    Fault,
    Limits,
    drift_fault,
    late_fault,
    moved_fault,
    room_fault,
)
from rfpipe.rigs.flicker import flicker_of, gain_or_flicker
from rfpipe.rigs.late import is_of_previous
from rfpipe.rigs.looks import (
    BLACK,
    Look,
    References,
    Series,
    common_gain,
    fit_of,
    gains_of,
    known_exposures,
)

Double = NDArray[np.float64]


def faults_of(looks: Sequence[Look], references: References, limits: Limits) -> list[Fault]:
    """Return the faults that looks show, in the order of mending.

    Looks without light, such as those under a lens cap, show none.

    Parameters
    ----------
    looks : sequence of Look
        In the order of taking.
    references : References
    limits : Limits
    """
    if not references.has_light or _are_dark(looks, references):
        return []
    late = _late(looks, references)
    if late is not None:
        return [late]
    faults = [room_change(looks, references, limits.room), motion(looks, references, limits.moved)]
    if faults[1] is None:  # gains of another picture mean nothing
        gains = gains_of(looks, references)
        faults.append(light_fault(gains, references.exposures, limits.light, references.unit))
    return [fault for fault in faults if fault is not None]


def light_fault(
    series: Series, exposures: Sequence[float], limit: float, unit: str = "s"
) -> Fault | None:
    """Return the fault of the light that multiplies: gain, flicker or drift; None for none.

    Parameters
    ----------
    series : Series
        Gains relative to a reference; NaN where an exposure is unknown.
    exposures : sequence of E floats
        Seconds.
    limit : float
        Accepted range of the gains.
    unit : str
        Unit of the times in `series`.
    """
    known = known_exposures(series, limit)
    if not known.any() or len(series.gain) < 2:
        return None
    gain, error = series.gain[:, known], series.error[:, known]
    span = np.ptp(gain, axis=0)
    is_change = (span > limit) & (span > SIGNIFICANCE * error.max(axis=0))
    if not is_change.any():
        return None
    size = float(span[is_change].max())
    flicker = flicker_of(series.ratio, series.ratio_error, exposures, np.ptp, SIGNIFICANCE)
    fault = gain_or_flicker(size, flicker, exposures)
    common, common_error = common_gain(series, limit)
    if fault.kind != "flicker" and _is_slow(series, common, common_error, limit):
        order = np.argsort(series.seconds)
        change = float(common[order[-1]] / common[order[0]] - 1)
        return drift_fault(change, f"{np.ptp(series.seconds):.2g} {unit}")
    return fault


def _are_dark(looks: Sequence[Look], references: References) -> bool:
    """Test whether all lit looks are black."""
    black = references.frames[BLACK]
    return all(
        is_of_previous(look.frames[:1], black, references.frames[look.picture])
        for look in looks
        if look.picture != BLACK
    )


def _late(looks: Sequence[Look], references: References) -> Fault | None:
    """Return the fault of frames that agree with the reference of the look before."""
    judged, late = 0, 0
    for before, look in pairwise(looks):
        if before.series == look.series and before.picture != look.picture:
            judged += 1
            late += is_of_previous(
                look.frames, references.frames[before.picture], references.frames[look.picture]
            )
    return late_fault(late / judged) if late else None


def room_change(looks: Sequence[Look], references: References, limit: float) -> Fault | None:
    """Return the fault of black pictures that differ.

    `limit` is relative to the white picture.
    """
    dark = [look for look in looks if look.picture == BLACK]
    seconds = [references.seconds, *(look.seconds for look in dark)]
    frames = np.array([references.frames[BLACK], *(look.frames for look in dark)])
    change, *ends = black_change(frames, references.exposures, references.saturated)
    size = change / references.white_rate
    if change == 0 or size < limit:
        return None
    duration = abs(seconds[ends[1]] - seconds[ends[0]])
    return room_fault(size, f"in {duration:.2g} {references.unit}")


def black_change(
    frames: Double, exposures: Sequence[float], saturated: float
) -> tuple[float, int, int]:
    """Return the largest change between black brackets (K, E, n), and the two brackets.

    The change is in counts a second of the longest exposure in which most pixels are below
    `saturated`, and 0 unless it is significant.
    """
    for index in range(len(exposures))[::-1]:
        counts = frames[:, index]
        usable = (counts < saturated).all(axis=0)
        if usable.mean() < 0.5:
            continue
        rates = counts[:, usable].mean(axis=1) / exposures[index]
        least, most = int(rates.argmin()), int(rates.argmax())
        change = (counts[most] - counts[least])[usable]
        is_noise = change.mean() < SIGNIFICANCE * change.std() / np.sqrt(change.size)
        return 0.0 if is_noise else float(rates[most] - rates[least]), least, most
    return 0.0, 0, 0


def motion(looks: Sequence[Look], references: References, limit: float) -> Fault | None:
    """Return the fault of a picture whose shape differs from its reference by more than a limit."""
    best = int(np.argmin(references.noise))
    lit = [look for look in looks if look.picture != BLACK]
    residual = max((fit_of(look, references).residual[best] for look in lit), default=np.nan)
    is_moved = residual > limit + 3 * references.noise[best]
    return moved_fault(float(residual)) if is_moved else None


def _is_slow(series: Series, common: Double, error: Double, limit: float) -> bool:
    """Test whether adjacent looks (K,) agree, or differ by no more than a steady drift."""
    adjacent = np.diff(series.series) == 0
    if not adjacent.any():
        return False
    step, duration = np.abs(np.diff(common))[adjacent], np.diff(series.seconds)[adjacent]
    rate = float(np.ptp(common)) / max(float(np.ptp(series.seconds)), 1e-9)
    allowed = np.maximum(limit / 2, 2 * rate * duration) + SIGNIFICANCE / 2 * error.max()
    return bool((step < allowed).all())
