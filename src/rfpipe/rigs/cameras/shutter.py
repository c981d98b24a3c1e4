"""Exposure times that a photo camera has: their names, and the times that they stand for."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from rfpipe.errors import InputError

__all__ = ["ShutterTime", "nearest_times", "shutter_times"]

_TIME = re.compile(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*(?:s|sec|\")?", re.I)

_OFF_THIRDS = 0.13
"""Stops by which a time of a camera set to thirds of a stop never misses one, as named."""


@dataclass(frozen=True)
class ShutterTime:
    """An exposure time.

    Attributes
    ----------
    name : str
        The camera's own, such as 1/60.
    seconds : float
        What it stands for, such as 1/64.
    """

    name: str
    seconds: float


def shutter_times(names: Iterable[str], *, nominal: bool = False) -> list[ShutterTime]:
    """Return a camera's exposure times, ascending; Bulb, Auto and the like are left out.

    Photo cameras time their shutters in halves or thirds of a stop from one second, whole powers
    of two among them, and round only the names: 1/60 is 1/64 s, 30 is 32 s.

    Parameters
    ----------
    names : iterable of str
        As the camera lists them.
    nominal : bool
        Whether to take the names at their word.
    """
    named = {name: _seconds(name) for name in names}
    times = {name: seconds for name, seconds in named.items() if seconds}
    if not nominal:
        stops = {name: math.log2(seconds) for name, seconds in times.items()}
        thirds = all(abs(stop - round(3 * stop) / 3) < _OFF_THIRDS for stop in stops.values())
        parts = 3 if thirds else 2
        times = {name: 2.0 ** (round(parts * stop) / parts) for name, stop in stops.items()}
    return sorted(
        (ShutterTime(name, seconds) for name, seconds in times.items()),
        key=lambda time: time.seconds,
    )


def nearest_times(exposures: Sequence[float], times: Sequence[ShutterTime]) -> list[ShutterTime]:
    """Return the camera's time nearest to each exposure, by their ratio.

    Raises
    ------
    InputError
        When the camera has none, or one is nearest to two exposures.
    """
    if not times:
        raise InputError(
            "the camera lists no exposure times; turn its mode dial to M (manual), and set the "
            "lens to manual focus"
        )
    chosen = [
        min(times, key=lambda time: abs(math.log(time.seconds / exposure)))
        for exposure in exposures
    ]
    for first, second in pairwise(chosen):
        if first.seconds >= second.seconds:
            raise InputError(
                f"sensor.exposures has two times for which the camera's nearest is {first.name}; "
                f"it has {', '.join(time.name for time in times)}"
            )
    return chosen


def _seconds(name: str) -> float | None:
    found = _TIME.fullmatch(name.strip())
    if found is None:
        return None
    return float(found[1]) / float(found[2] or 1)
