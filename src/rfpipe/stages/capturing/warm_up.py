"""Waiting for the lamp: projectors change by percents in their first minutes."""

from __future__ import annotations

import logging
from pathlib import Path
from time import monotonic, sleep, time

import numpy as np

from rfpipe.keys import WARM_UP_KEY
from rfpipe.rigs import Rig

__all__ = ["seconds_since_capture", "warm_up"]

# The floodlit pattern stays up between two looks at its brightness.
_SECONDS_BETWEEN_LOOKS = 30.0

_log = logging.getLogger(__name__)


def seconds_since_capture(folder: Path) -> float:
    """Return how long ago the last bracket was taken into an acquisition's folder.

    Infinite if none was: the lamp may have been off.
    """
    journals = [journal.stat().st_mtime for journal in folder.glob("L*/*.zarr/journal.jsonl")]
    return time() - max(journals) if journals else float("inf")


def warm_up(rig: Rig, minutes: float) -> None:
    """Show the all-on pattern for some minutes, and log how its brightness settles.

    Parameters
    ----------
    rig : Rig
    minutes : float
        Above 0.
    """
    white = np.ones((1, *rig.projector_shape), np.float32)
    began = monotonic()
    _log.info("the lamp warms up for %.3g minutes (capture.warm_up_minutes)", minutes)
    before: float | None = None
    index = 0
    while (rest := 60 * minutes - (monotonic() - began)) > 0:
        frames = rig.capture(white, [(WARM_UP_KEY, index)])
        brightness = float(frames.mean(dtype=np.float64))
        if before:
            _log.info(
                "warming up: %.0f s to go, the picture's mean changed by %+.2f %%",
                rest, 100 * (brightness / before - 1),
            )  # fmt: skip
        before, index = brightness, index + 1
        sleep(min(_SECONDS_BETWEEN_LOOKS, max(0.0, 60 * minutes - (monotonic() - began))))
