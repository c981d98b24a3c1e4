"""From display to camera: how long after a picture was drawn the camera sees it, and it alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import driving, uniform
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.provenance import generator
from rfpipe.rigs.devices import Camera, Projector

Double = NDArray[np.float64]

LONGEST_SECONDS = 4.0
"""Longest delay that is looked for."""

PICTURES = 8
"""Pictures shown where no wait is needed."""

_TRIALS = 4  # pictures after each wait, black and white by turns
_PERIOD_SECONDS = 0.02  # of a display: trials begin anywhere in it, and it is added to a proposal
_OFF = 0.05  # share of the step that a cell may still lack
_CELLS = 8  # along either side: a display that is drawn row by row is late in some


@dataclass(frozen=True)
class _Look:
    """Means of the first exposure's cells, and their noise, under a settled picture."""

    mean: Double
    noise: float

    def step_from(self, before: _Look, seen: Double) -> float:
        """Return the least share of the step to this picture, 1 where all is within noise."""
        step = self.mean - before.mean
        lit = np.abs(step) >= 0.1 * np.abs(step).max()
        share = (seen - before.mean)[lit] / step[lit]
        allowed = _OFF + 6 * max(self.noise, before.noise) / np.abs(step[lit])
        return 1.0 if (share >= 1 - allowed).all() else min(float(share.min()), 1 - _OFF)


def measure_latency(
    projector: Projector, camera: Camera, advance: Callable[[int], None] = lambda _: None
) -> Findings:
    """Switch between black and white, and find the wait after which the first exposure is right.

    Parameters
    ----------
    projector : Projector
    camera : Camera
    advance : callable, optional
        Counts pictures, of which there are `PICTURES` or more.

    Returns
    -------
    Findings
        Arrays: ``waits`` in seconds, and ``worst`` after each, of trials and cells the least share
        of the step that was seen, 1 for the new picture and 0 for the one before.

    Raises
    ------
    CaptureError
        When white isn't told from black.
    """
    show = getattr(projector, "show_now", projector.show)

    def look(weight: float, wait: float) -> Double:
        with driving():
            show(uniform(projector, weight))
            time.sleep(wait)
            frame = np.asarray(camera.expose())[0].astype(np.float64)
        advance(1)
        rows, columns = (np.array_split(np.arange(n), min(n, _CELLS)) for n in frame.shape[:2])
        return np.array([frame[np.ix_(row, column)].mean() for row in rows for column in columns])

    settled, settle_wait = _settled(look)
    random, found, weight = generator(0), {}, 0

    def is_right(wait: float) -> bool:
        nonlocal weight
        worst = 1.0
        for _ in range(_TRIALS):
            weight = 1 - weight
            time.sleep(_PERIOD_SECONDS * random.random())
            seen = look(weight, wait)
            worst = min(worst, settled[weight].step_from(settled[1 - weight], seen))
            time.sleep(settle_wait)
        found[wait] = worst
        return worst == 1

    right, wrong = 0.0, 0.0
    while not is_right(right):
        wrong, right = right, max(1 / 128, 2 * right)
        if right > LONGEST_SECONDS:
            break
    while wrong < right <= LONGEST_SECONDS and right - wrong > max(0.002, 0.1 * right):
        middle = (right + wrong) / 2
        right, wrong = (middle, wrong) if is_right(middle) else (right, middle)
    waits = sorted(found)
    worst = np.array([found[wait] for wait in waits])
    arrays = {"waits": np.array(waits), "worst": worst}
    bracket = sum(camera.sensor.exposures)
    facts = _facts(right, wrong, getattr(projector, "settle_seconds", None), bracket)
    return Findings.of("latency", {**facts, "trials": _TRIALS * len(waits)}, arrays)


def _facts(right: float, wrong: float, settle: float | None, bracket: float) -> dict[str, Any]:
    """Compare the least right wait with the settings'; all in seconds."""
    if right > LONGEST_SECONDS:
        none = "delay_seconds", "delay_ms", "proposed_settle_seconds"
        others = "early_seconds", "short_seconds", "spared_share"
        facts: dict[str, Any] = dict.fromkeys([*none, *others])
        return {**facts, "unsettled_seconds": wrong, "settle_seconds": settle}
    proposed = round(1.25 * right + _PERIOD_SECONDS, 3)
    is_long = settle is not None and settle > 2 * proposed
    return {
        "delay_seconds": right,
        "delay_ms": 1000 * right,
        "settle_seconds": settle,
        "proposed_settle_seconds": proposed,
        "unsettled_seconds": None,
        "early_seconds": right if settle is None else None,
        "short_seconds": None if settle is None else right - settle,
        "spared_share": (settle - proposed) / (settle + bracket) if settle and is_long else None,
    }


def _settled(look: Callable[[float, float], Double]) -> tuple[tuple[_Look, _Look], float]:
    """Return black and white, each seen twice alike, and the wait that it took."""
    wait = 0.2
    while wait <= LONGEST_SECONDS:
        off, on, on_again, off_again = (look(weight, wait) for weight in (0, 1, 1, 0))
        black, white = (off + off_again) / 2, (on + on_again) / 2
        apart = np.abs(off - off_again), np.abs(on - on_again)
        if max(one.max() for one in apart) < _OFF * np.abs(white - black).max():
            looks = (_Look(black, float(apart[0].mean())), _Look(white, float(apart[1].mean())))
            return looks, wait
        wait *= 2
    raise CaptureError(
        "the camera's shortest exposure doesn't tell a white picture from a black one. Is the lens "
        "open, does the projector light the scene, and is the exposure long enough?"
    )
