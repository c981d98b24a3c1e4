"""Brightness of the lamp at each pattern of a level, and other changes, from check pictures.

The brightness at a pattern is interpolated between the check pictures before and after it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from rfpipe.array_types import Double
from rfpipe.references.check_pictures import check_positions, first_check_picture
from rfpipe.references.comparison import Difference, compare_pictures
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.references.steadiness import is_smooth
from rfpipe.rigs.faults import (
    AUTOMATIC_OFF,
    CAPTURE,
    GAIN_CHANGES,
    RIG_MOVED,
    SIGNIFICANCE,
    room_fault,
)
from rfpipe.storage.base import CHECK_PICTURES, Storage, level_name, scheduled_levels

_log = logging.getLogger(__name__)


class Drift(NamedTuple):
    """Brightness of the lamp during a level.

    Attributes
    ----------
    gains : ndarray of float64, shape (patterns, C), or None
        Brightness to divide the images by; None to leave the images as they are.
    facts : dict
        Entries for the manifest of the level's merge; empty without check pictures.
    """

    gains: Double | None
    facts: dict[str, Any]


def measure_drift(
    storage: Storage,
    references: ReferenceImages,
    level: int,
    *,
    divide_out: bool,
    is_steady: bool = True,
) -> Drift:
    """Estimate brightness and other changes from a level's check pictures; log a change.

    Parameters
    ----------
    storage : Storage
        The level is captured.
    references : ReferenceImages
    level : int
    divide_out : bool
        Whether images are to be divided by the brightness. A gain that changes from picture to
        picture is not divided out.
    is_steady : bool
        Whether the gain was steady during the reference brackets.
    """
    captured = storage.read_manifest(level, "capture")
    first = first_check_picture(storage, references) if CHECK_PICTURES in captured else None
    if first is None:
        return Drift(None, {})
    with storage.pictures(level, "capture", CHECK_PICTURES) as store:
        brackets = (store.read(n, n + 1) for n in range(store.shape[0]))
        differences = [compare_pictures(references, first, bracket) for bracket in brackets]
    gain = np.stack([difference.gain for difference in differences])
    is_moved = max(difference.residual for difference in differences) > CAPTURE.moved
    # the gain isn't comparable where the picture changed
    is_steady &= is_moved or is_smooth(*_gains_so_far(storage, level, gain, captured))
    facts = {
        "interval": captured[CHECK_PICTURES]["interval"],
        "change": _rounded(difference.residual for difference in differences),
        "room": _rounded(difference.room for difference in differences),
        "gain": gain.tolist(),
        "deviation": [difference.deviation.tolist() for difference in differences],
        "moved": is_moved,
        "steady": is_steady,
        "divided_out": divide_out and is_steady,
    }
    _log_brightness(level, differences, facts, divide_out=divide_out)
    gains = _at_patterns(gain, captured) if facts["divided_out"] else None
    return Drift(gains, {CHECK_PICTURES: facts})


def changes_of(facts: dict[str, Any]) -> list[str]:
    """Describe the harmful changes during a level, from the facts of `measure_drift`."""
    changes = [RIG_MOVED] if facts["moved"] else []
    if not facts["steady"]:
        changes.append(GAIN_CHANGES)
    sizes = [abs(size) for size in facts["room"]]
    room = room_fault(max(sizes, default=0.0), f"in {len(sizes)} check pictures")
    if room.exceeds(CAPTURE):
        changes.append(room.change)
    return changes


def _rounded(values: Iterable[float]) -> list[float]:
    return [float(f"{value:.4g}") for value in values]


def _at_patterns(gain: Double, captured: dict[str, Any]) -> Double:
    """Interpolate the brightness of check pictures, (n, C), at a level's patterns."""
    patterns, interval = captured["patterns"], captured[CHECK_PICTURES]["interval"]
    times, check_times = np.arange(patterns) + 0.5, check_positions(patterns, interval)
    return np.stack([np.interp(times, check_times, channel) for channel in gain.T], axis=1)


def _gains_so_far(
    storage: Storage, level: int, gain: Double, captured: dict[str, Any]
) -> tuple[Double, Double]:
    """Collect the brightness of all check pictures up to a level.

    Returns
    -------
    gains : ndarray of float64, shape (n, C)
    times : ndarray of float64, shape (n,)
        Number of pictures taken before each check picture.
    """
    earlier = [above for above in scheduled_levels(storage) if above < level]
    merged = {above: storage.read_manifest(above, "merge") for above in earlier}
    series = [
        (np.asarray(facts[CHECK_PICTURES]["gain"]), facts[CHECK_PICTURES]["interval"], facts)
        for facts in merged.values()
        if CHECK_PICTURES in facts
    ]
    series.append((gain, captured[CHECK_PICTURES]["interval"], captured))
    times, pictures_before = [], 0.0
    for level_gain, interval, facts in series:
        positions = check_positions(facts["patterns"], interval)
        times.append(pictures_before + positions + np.arange(len(level_gain)))
        pictures_before += facts["patterns"] + len(level_gain)
    return np.concatenate([level_gain for level_gain, *_ in series]), np.concatenate(times)


def _log_brightness(
    level: int, differences: list[Difference], facts: dict[str, Any], *, divide_out: bool
) -> None:
    """Log a change of brightness that exceeds the noise, and how it is treated.

    Brightness is relative to the acquisition's first check picture, which may be of another level.
    """
    gains = [difference.gain for difference in differences]
    span = np.ptp([np.ones_like(gains[0]), *gains], axis=0)
    noise = np.max([difference.deviation for difference in differences], axis=0)
    if not (span > SIGNIFICANCE * np.sqrt(2) * noise).any():
        return
    if facts["divided_out"]:
        advice = "it is divided out"
    elif divide_out:
        advice = f"{GAIN_CHANGES}, so that it can't be divided out: {AUTOMATIC_OFF}"
    else:
        advice = "merge.divide_out_drift would divide it out"
    _log.warning(
        "%s: the lamp's light changed by %.2g %% (noise %.2g %%) in %d check pictures; %s",
        level_name(level), 100 * span.max(), 100 * noise.max(), len(differences), advice,
    )  # fmt: skip
