"""Diagnosis of a rig's faults from check pictures; see `rfpipe.rigs.check_pictures`.

With the references R_B, R_P and R_Q of black, a pattern and its complement, a check picture F is

    F = R_B + x_P (R_P - R_B) + x_Q (R_Q - R_B) + a

======== ======== ===================================================================
symbol   shape    faults that change it
======== ======== ===================================================================
R_B      (E, n)   room
g        (E,)     gain, flicker, drift; g is x_P - x_Q of a picture of P
r        (E,)     motion; r is the residual of the equation
======== ======== ===================================================================

- Gain and lamp multiply the light and change g. Light of the room is added: to `a` as haze, and to
  x_P and x_Q equally where the scene reflects it, since ``P + Q`` is a white picture. It does not
  change g; it changes the pictures of black.
- A change of gain is common to all exposures of a bracket; flicker is not, see
  `rfpipe.rigs.flicker`.
- A lamp drifts slowly: adjacent pictures agree, distant ones do not.
- Motion changes the picture's shape: r rises.
- Late frames agree with the reference of the previous picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from rfpipe.array_types import Double
from rfpipe.rigs.check_pictures import (
    BLACK,
    CheckPicture,
    LightSeries,
    References,
    common_gain,
    fit_picture,
    known_exposures,
    measured_light,
)
from rfpipe.rigs.faults import (
    SIGNIFICANCE,
    AcceptedChanges,
    Fault,
    drift_fault,
    late_fault,
    moved_fault,
    room_fault,
)
from rfpipe.rigs.flicker import flicker_of, gain_or_flicker
from rfpipe.rigs.late import is_of_previous


def diagnose(
    pictures: Sequence[CheckPicture], references: References, limits: AcceptedChanges
) -> list[Fault]:
    """Find the faults that check pictures show, the one to mend first first.

    Parameters
    ----------
    pictures : sequence of CheckPicture
        In the order of capture.
    references : References
    limits : AcceptedChanges

    Returns
    -------
    list of Fault
        Empty where the pictures have no light, as under a lens cap.
    """
    if not references.has_light or _are_dark(pictures, references):
        return []
    late = _late(pictures, references)
    if late is not None:
        return [late]
    faults = [
        room_change(pictures, references, limits.room),
        motion(pictures, references, limits.moved),
    ]
    if faults[1] is None:  # after motion, gains are meaningless
        gains = measured_light(pictures, references)
        faults.append(light_fault(gains, references.exposures, limits.light, references.unit))
    return [fault for fault in faults if fault is not None]


def light_fault(
    series: LightSeries, exposures: Sequence[float], limit: float, unit: str = "s"
) -> Fault | None:
    """Find a fault that multiplies the light: gain, flicker or drift; None without one.

    Parameters
    ----------
    series : LightSeries
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
    span, error = (values[known] for values in light_range(series))
    is_change = (span > limit) & (span > SIGNIFICANCE * error)
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


def light_range(series: LightSeries) -> tuple[Double, Double]:
    """Range of the gains in each exposure (E,), and their largest standard error."""
    return np.ptp(series.gain, axis=0), series.error.max(axis=0)


def _are_dark(pictures: Sequence[CheckPicture], references: References) -> bool:
    """Test whether all pictures of lit patterns are black."""
    black = references.frames[BLACK]
    return all(
        is_of_previous(picture.frames[:1], black, references.frames[picture.kind])
        for picture in pictures
        if picture.kind != BLACK
    )


def _late(pictures: Sequence[CheckPicture], references: References) -> Fault | None:
    """Find frames that agree with the reference of the previous picture."""
    compared, late = 0, 0
    for previous, picture in pairwise(pictures):
        if previous.series == picture.series and previous.kind != picture.kind:
            compared += 1
            late += is_of_previous(
                picture.frames, references.frames[previous.kind], references.frames[picture.kind]
            )
    return late_fault(late / compared) if late else None


def room_change(
    pictures: Sequence[CheckPicture], references: References, limit: float
) -> Fault | None:
    """Find a change of the room's light from the black pictures.

    `limit` is relative to the white picture's light.
    """
    dark = [picture for picture in pictures if picture.kind == BLACK]
    seconds = [references.seconds, *(picture.seconds for picture in dark)]
    frames = np.array([references.frames[BLACK], *(picture.frames for picture in dark)])
    change, *ends = black_change(frames, references.exposures, references.saturated)
    size = change / references.white_rate
    if change == 0 or size < limit:
        return None
    duration = abs(seconds[ends[1]] - seconds[ends[0]])
    return room_fault(size, f"in {duration:.2g} {references.unit}")


def black_change(
    frames: Double, exposures: Sequence[float], saturated: float
) -> tuple[float, int, int]:
    """Find the largest change between black brackets (K, E, n), and the indices of the two.

    The change is in counts per second, measured in the longest exposure in which at least half of
    the pixels are below `saturated`; it is 0 unless it is significant.
    """
    for index in range(len(exposures))[::-1]:
        counts = frames[:, index]
        usable = (counts < saturated).all(axis=0)
        if usable.mean() < 0.5:
            continue
        rates = counts[:, usable].mean(axis=1) / exposures[index]
        smallest, largest = int(rates.argmin()), int(rates.argmax())
        change = (counts[largest] - counts[smallest])[usable]
        is_noise = change.mean() < SIGNIFICANCE * change.std() / np.sqrt(change.size)
        return 0.0 if is_noise else float(rates[largest] - rates[smallest]), smallest, largest
    return 0.0, 0, 0


def motion(pictures: Sequence[CheckPicture], references: References, limit: float) -> Fault | None:
    """Find a picture whose shape differs from its reference by more than `limit`."""
    best = int(np.argmin(references.noise))
    lit = [picture for picture in pictures if picture.kind != BLACK]
    residual = max(
        (fit_picture(picture, references).residual[best] for picture in lit), default=np.nan
    )
    is_moved = residual > limit + 3 * references.noise[best]
    return moved_fault(float(residual)) if is_moved else None


def _is_slow(series: LightSeries, common: Double, error: Double, limit: float) -> bool:
    """Test whether adjacent pictures (K,) differ by no more than noise and a steady drift."""
    adjacent = np.diff(series.series) == 0
    if not adjacent.any():
        return False
    step, duration = np.abs(np.diff(common))[adjacent], np.diff(series.seconds)[adjacent]
    rate = float(np.ptp(common)) / max(float(np.ptp(series.seconds)), 1e-9)
    allowed = np.maximum(limit / 2, 2 * rate * duration) + SIGNIFICANCE / 2 * error.max()
    return bool((step < allowed).all())
