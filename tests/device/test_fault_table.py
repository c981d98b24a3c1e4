"""Six faults by three steps: what calibration, capture and offline import must say of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rfpipe.testing import faults

Devices = tuple[Any, Any]


class Case(NamedTuple):
    """A fault, and a regular expression of what each step says about it."""

    inject: Callable[[Any, Any, int], Devices]
    said: str


FAULTS: dict[str, Case] = {
    "late": Case(
        lambda projector, camera, after: (projector, faults.LateCamera(camera, after)),
        r"frames are of the picture before.*(queue|settle_seconds|latency)",
    ),
    "gain": Case(
        lambda projector, camera, after: (projector, faults.jittering_gain(camera, after)),
        r"gain changes from picture to picture.*automatic gain",
    ),
    "flicker": Case(
        lambda projector, camera, after: (projector, faults.flickering_lamp(camera, after)),
        r"flicker.*whole periods",
    ),
    "room": Case(
        lambda projector, camera, after: (projector, faults.changing_room_light(camera, after)),
        r"room's light chang.*%",
    ),
    "drift": Case(
        lambda projector, camera, after: (projector, faults.drifting_lamp(camera, after)),
        r"lamp.*(drift|chang).*%",
    ),
    "geometry": Case(
        lambda projector, camera, after: (projector, faults.moved_camera(camera, after)),
        r"moved",
    ),
}
"""By name; ``inject(projector, camera, after)`` returns the devices with the fault."""
