"""Brightness of the lamp at each pattern of a level, and other changes, by the looks at the rig.

Looks are repeated pictures of one pattern, see `rfpipe.stages.watch`. Brightness at a pattern is
interpolated between the looks before and after it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.references.check_pictures import check_positions, first_check_picture
from rfpipe.references.comparison import change
from rfpipe.references.reference_images import Merger
from rfpipe.references.steadiness import smooth_changes
from rfpipe.rigs.faults import (
    AUTOMATIC_OFF,
    CAPTURE,
    GAIN_CHANGES,
    RIG_MOVED,
    SIGNIFICANCE,
    room_fault,
)
from rfpipe.storage.files import CHECK_PICTURES, AcquisitionFolder, name_of

Double = NDArray[np.float64]

_log = logging.getLogger(__name__)


def measure_looks(
    folder: AcquisitionFolder,
    merger: Merger,
    level: int,
    *,
    divide_out: bool,
    is_steady: bool = True,
) -> tuple[Double | None, dict[str, Any]]:
    """Measure brightness and changes by the looks at a level, and log a change of the lamp.

    Brightness of gain that changes from picture to picture is not to be divided by: `is_steady` is
    whether the white pictures at the acquisition's beginning were steady.

    Returns brightness at each pattern to divide by, float64 (patterns, C), None not to divide; and
    facts for the manifest.
    """
    captured = folder.read_manifest(level, "capture")
    known = first_check_picture(folder, merger) if CHECK_PICTURES in captured else None
    if known is None:
        return None, {}
    every = captured[CHECK_PICTURES]["interval"]
    with folder.frames(level, "capture", CHECK_PICTURES) as frames:
        taken = (frames.read(n, n + 1) for n in range(frames.shape[0]))
        looks = [change(merger, known, bracket) for bracket in taken]
    gain = np.stack([look.gain for look in looks])
    deviation = np.stack([look.deviation for look in looks])
    is_moved = max(look.rest for look in looks) > CAPTURE.moved
    # brightness of another picture does not show gain
    is_steady &= is_moved or smooth_changes(*_series(folder, level, gain, captured))
    facts = {
        "interval": every, "gain": gain.tolist(), "deviation": deviation.tolist(),
        "change": _rounded(look.rest for look in looks),
        "room": _rounded(look.room for look in looks),
        "moved": is_moved,
        "steady": is_steady, "divided_out": divide_out and is_steady,
    }  # fmt: skip
    _log_brightness(level, gain, deviation, facts, divide_out=divide_out)
    if not facts["divided_out"]:
        return None, {CHECK_PICTURES: facts}
    at, looked = np.arange(captured["patterns"]) + 0.5, check_positions(captured["patterns"], every)
    gains = np.stack([np.interp(at, looked, of_channel) for of_channel in gain.T], axis=1)
    return gains, {CHECK_PICTURES: facts}


def alarms_of(facts: dict[str, Any]) -> list[str]:
    """Describe what the looks at a level saw, from their facts in its merge's manifest."""
    alarms = [RIG_MOVED] if facts["moved"] else []
    if not facts.get("steady", True):
        alarms.append(GAIN_CHANGES)
    changes = [abs(change) for change in facts.get("room", [])]
    room = room_fault(max(changes, default=0.0), f"in {len(changes)} looks")
    if room.exceeds(CAPTURE):
        alarms.append(room.change)
    return alarms


def _rounded(values: Iterable[float]) -> list[float]:
    return [float(f"{value:.4g}") for value in values]


def _series(
    folder: AcquisitionFolder, level: int, gain: Double, captured: dict[str, Any]
) -> tuple[Double, Double]:
    """Brightness by all looks down to a level, (looks, C), and the pictures before each."""
    gains, times, before = [], [], 0.0
    for above in (*folder.levels_above(level), level):
        if above == level:
            of_level, every, patterns = (
                gain,
                captured[CHECK_PICTURES]["interval"],
                captured["patterns"],
            )
        else:
            facts = folder.read_manifest(above, "merge")
            if CHECK_PICTURES not in facts:
                continue
            of_level = np.asarray(facts[CHECK_PICTURES]["gain"])
            every, patterns = facts[CHECK_PICTURES]["interval"], facts["patterns"]
        gains.append(of_level)
        times.append(before + check_positions(patterns, every) + np.arange(len(of_level)))
        before += patterns + len(of_level)
    return np.concatenate(gains), np.concatenate(times)


def _log_brightness(
    level: int, gain: Double, deviation: Double, facts: dict[str, Any], *, divide_out: bool
) -> None:
    """Log a change of brightness (looks, C) beyond noise, and what becomes of it."""
    span, noise = np.ptp(gain, axis=0), deviation.max(axis=0)
    if not (span > SIGNIFICANCE * np.sqrt(2) * noise).any():
        return
    if facts["divided_out"]:
        advice = "it is divided out"
    elif divide_out:
        advice = f"{GAIN_CHANGES}, so that it can't be divided out: {AUTOMATIC_OFF}"
    else:
        advice = "merge.divide_out_drift would divide it out"
    _log.warning(
        "%s: the lamp's light changed by %.2g %% (noise %.2g %%) in %d looks; %s",
        name_of(level), 100 * span.max(), 100 * noise.max(), len(gain), advice,
    )  # fmt: skip
