"""From display to camera: how long after a picture was drawn the camera sees it, and it alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench, driving
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.provenance import generator

Double = NDArray[np.float64]

LONGEST_SECONDS = 4.0
"""Longest delay that is looked for."""

PICTURES = 8
"""Pictures shown where no wait is needed."""

_TRIALS = 4  # pictures after each wait, black and white by turns
_PERIOD_SECONDS = 0.02  # of a display: trials begin anywhere in it, and it is added to a proposal
_OFF = 0.05  # share of the step that a cell may still lack
_CELLS = 8  # along either side: a display that is drawn row by row is late in some


def measure_latency(bench: Bench) -> Findings:
    """Switch between black and white, and find the wait after which the first exposure is right.

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
    with bench.progress(PICTURES) as counts:

        def look(weight: int, wait: float) -> Double:
            """Return the means of the first exposure's cells."""
            with driving():
                getattr(bench.projector, "show_now", bench.projector.show)(bench.flat(weight))
                time.sleep(wait)
                frame = np.asarray(bench.camera.expose())[0].astype(np.float64)
            if counts is not None:
                counts.advance(1)
            rows, columns = (np.array_split(np.arange(n), min(n, _CELLS)) for n in frame.shape[:2])
            return np.array([frame[np.ix_(y, x)].mean() for y in rows for x in columns])

        settled, allowed, wait = _settled(look)
        random, found, weight = generator(0), dict[float, float](), 0

        def is_right(after: float) -> bool:
            nonlocal weight
            worst = 1.0
            for _ in range(_TRIALS):
                weight = 1 - weight
                time.sleep(_PERIOD_SECONDS * random.random())
                before, now = settled[1 - weight], settled[weight]
                share = (look(weight, after) - before) / np.where(now == before, 1, now - before)
                if (share < 1 - allowed).any():
                    worst = min(worst, float(share[np.isfinite(allowed)].min()), 1 - _OFF)
                time.sleep(wait)
            found[after] = worst
            return worst == 1

        right, wrong = 0.0, 0.0
        while right <= LONGEST_SECONDS and not is_right(right):
            wrong, right = right, max(1 / 128, 2 * right)
        while wrong < right <= LONGEST_SECONDS and right - wrong > max(0.002, 0.1 * right):
            middle = (right + wrong) / 2
            right, wrong = (middle, wrong) if is_right(middle) else (right, middle)
    waits = sorted(found)
    arrays = {"waits": np.array(waits), "worst": np.array([found[wait] for wait in waits])}
    settle = getattr(bench.projector, "settle_seconds", 0.0)
    facts: dict[str, Any] = {"settle_seconds": settle, "trials": _TRIALS * len(waits)}
    if right > LONGEST_SECONDS:
        facts["unsettled_seconds"] = wrong
    else:
        facts |= {
            "delay_seconds": right,
            "delay_ms": 1000 * right,
            "proposed_settle_seconds": round(1.25 * right + _PERIOD_SECONDS, 3),
            "short_seconds": right - settle,
        }
    return Findings.of("latency", facts, arrays)


def _settled(look: Callable[[int, float], Double]) -> tuple[Double, Double, float]:
    """Return black and white, each seen twice alike, and the wait that it took.

    And the share of the step that each cell may lack, infinite where the step is hardly seen.
    """
    wait = 0.2
    while wait <= LONGEST_SECONDS:
        black, white, white_again, black_again = (look(weight, wait) for weight in (0, 1, 1, 0))
        settled = np.array([black + black_again, white + white_again]) / 2
        apart = np.abs([black - black_again, white - white_again])
        step = np.abs(settled[1] - settled[0])
        if apart.max() < _OFF * step.max():
            allowed = _OFF + 6 * apart.mean(axis=1).max() / np.maximum(step, 1e-9)
            return settled, np.where(step >= 0.1 * step.max(), allowed, np.inf), wait
        wait *= 2
    raise CaptureError(
        "the camera's shortest exposure doesn't tell a white picture from a black one. Is the lens "
        "open, does the projector light the scene, and is the exposure long enough?"
    )
