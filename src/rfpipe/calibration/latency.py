"""From display to camera: how long after a picture was drawn the camera sees it, and it alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench, driving
from rfpipe.calibration.steadiness import probe, with_faults
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.errors import CaptureError
from rfpipe.provenance import generator

Double = NDArray[np.float64]

Look = Callable[[int, float], Double]
"""``look(weight, wait)`` shows black or white, waits, and returns the means of cells."""

LONGEST_SECONDS = 4.0
"""Longest delay that is looked for."""

PICTURES = 8
"""Pictures shown where no wait is needed."""

_TRIALS = 4  # pictures after each wait, black and white by turns
_PERIOD_SECONDS = 0.02  # of a display: trials begin anywhere in it, and it is added to a proposal
_OFF = 0.05  # share of the step that a cell may still lack
PROBE_SECONDS = 1.0  # wait beyond any usual display's delay, where black and white never settle
_CELLS = 8  # along either side: a display that is drawn row by row is late in some


def measure_latency(bench: Bench) -> Findings:
    """Switch between black and white, and find the wait after which the first exposure is right.

    A delay is believed only where longer waits show the same pattern alike: light, gain or a queue
    of frames that change the picture are named instead.

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

        settled = _settled(look)
        delay = None if settled is None else _delay(look, settled)
    if delay is None or settled is None:
        faults = probe(bench, PROBE_SECONDS)[2]
        if not faults:
            raise CaptureError(
                "the camera's shortest exposure doesn't tell a white picture from a black one. Is "
                "the lens open, does the projector light the scene, and is the exposure long "
                "enough?"
            )
        return with_faults(Findings(Verdict("failed", "")), faults)
    findings = _findings(bench, *delay)
    if findings.verdict.standing == "good":
        return findings
    return with_faults(findings, probe(bench, settled.wait)[2])


def _delay(look: Look, settled: Settled) -> tuple[float, float, dict[float, float]]:
    """Return a wait that is right, one that is wrong, and what was seen after each wait."""
    random, found, weight = generator(0), dict[float, float](), 0

    def is_right(after: float) -> bool:
        nonlocal weight
        worst = 1.0
        for _ in range(_TRIALS):
            weight = 1 - weight
            time.sleep(_PERIOD_SECONDS * random.random())
            before, now = settled.means[1 - weight], settled.means[weight]
            share = (look(weight, after) - before) / np.where(now == before, 1, now - before)
            if (share < 1 - settled.allowed).any():
                worst = min(worst, float(share[np.isfinite(settled.allowed)].min()), 1 - _OFF)
            time.sleep(settled.wait)
        found[after] = worst
        return worst == 1

    right, wrong = 0.0, 0.0
    while right <= LONGEST_SECONDS and not is_right(right):
        wrong, right = right, max(1 / 128, 2 * right)
    while wrong < right <= LONGEST_SECONDS and right - wrong > max(0.002, 0.1 * right):
        middle = (right + wrong) / 2
        right, wrong = (middle, wrong) if is_right(middle) else (right, middle)
    return right, wrong, found


def _findings(bench: Bench, right: float, wrong: float, found: dict[float, float]) -> Findings:
    """Judge the waits of `_delay`."""
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


class Settled(NamedTuple):
    """Black and white (2, cells), the wait that they take, and what each cell may lack of the step.

    `allowed` is a share, infinite where the step is hardly seen.
    """

    means: Double
    wait: float
    allowed: Double


def _settled(look: Look) -> Settled | None:
    """Return black and white, each seen twice alike; None where they never are."""
    wait = 0.2
    while wait <= LONGEST_SECONDS:
        black, white, white_again, black_again = (look(weight, wait) for weight in (0, 1, 1, 0))
        settled = np.array([black + black_again, white + white_again]) / 2
        apart = np.abs([black - black_again, white - white_again])
        step = np.abs(settled[1] - settled[0])
        if apart.max() < _OFF * step.max():
            allowed = _OFF + 6 * apart.mean(axis=1).max() / np.maximum(step, 1e-9)
            return Settled(settled, wait, np.where(step >= 0.1 * step.max(), allowed, np.inf))
        wait *= 2
    return None
