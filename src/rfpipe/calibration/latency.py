"""Delay from display to camera, after which the camera sees the new picture only."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.calibration.context import StepContext, device_errors
from rfpipe.calibration.steadiness import probe, with_faults
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.errors import CaptureError
from rfpipe.provenance import generator
from rfpipe.rigs.devices import Projector

CellMeans = Callable[[int, float], Double]
"""``cell_means(weight, wait)`` shows black or white, waits, and returns means of cells, (n,)."""

LONGEST_SECONDS = 4.0
"""Longest delay that is measured."""

PICTURES = 8
"""Number of pictures shown for a display without delay."""

_TRIALS = 4  # pictures after each wait, alternately black and white
_PERIOD_SECONDS = 0.02  # refresh period: trials begin at random in it; a proposal adds it
_TOLERANCE = 0.05  # accepted deviation of a cell, relative to the step from black to white
PROBE_SECONDS = 1.0  # wait longer than any usual display's delay, where the light never settles
_CELLS = 8  # cells along either side; a display drawn row by row is late in some of them


def measure_latency(context: StepContext) -> Findings:
    """Switch between black and white, and find the wait after which the first exposure is correct.

    A delay is accepted only where pictures after longer waits agree; otherwise the verdict names
    the cause: light, gain or a queue of frames.

    Returns
    -------
    Findings
        Arrays: ``waits`` in seconds; ``worst``, for each wait the smallest fraction of the step
        from the previous picture (0) to the new one (1), over trials and cells.

    Raises
    ------
    CaptureError
        When white pictures aren't brighter than black ones.
    """
    with context.progress(PICTURES) as bar:

        def cell_means(weight: int, wait: float) -> Double:
            with device_errors():
                _show_now(context.projector, context.flat_picture(weight))
                time.sleep(wait)
                frame = np.asarray(context.camera.expose())[0].astype(np.float64)
            if bar is not None:
                bar.advance(1)
            rows, columns = (np.array_split(np.arange(n), min(n, _CELLS)) for n in frame.shape[:2])
            return np.array([frame[np.ix_(y, x)].mean() for y in rows for x in columns])

        settled = _settled(cell_means)
        delay = None if settled is None else _delay(cell_means, settled)
    if delay is None or settled is None:
        faults = probe(context, PROBE_SECONDS)[2]
        if not faults:
            raise CaptureError(
                "white pictures are not brighter than black ones in the camera's shortest exposure",
                remedy="Check that the lens is open, that the projector lights the scene, and "
                "that the exposure is long enough",
            )
        return with_faults(Findings(Verdict("failed", "")), faults)
    findings = _findings(context, delay)
    if findings.verdict.standing == "good":
        return findings
    return with_faults(findings, probe(context, settled.wait)[2])


def _show_now(projector: Projector, picture: NDArray[np.float32]) -> None:
    """Show a picture, without waiting until it has settled where the projector can do so."""
    show = getattr(projector, "show_now", projector.show)
    show(picture)


class Delay(NamedTuple):
    """Result of the search for the delay.

    Attributes
    ----------
    sufficient, insufficient : float
        Shortest wait in seconds after which all pictures were right, and longest one after which
        some were wrong; 0 for both where no wait is needed.
    worst : dict
        Smallest fraction of the step from black to white or back, by wait.
    """

    sufficient: float
    insufficient: float
    worst: dict[float, float]


def _delay(cell_means: CellMeans, settled: Settled) -> Delay:
    """Search the delay: double the wait until pictures are right, then bisect."""
    random, fractions, weight = generator(0), dict[float, float](), 0

    def is_sufficient(wait: float) -> bool:
        nonlocal weight
        worst = 1.0
        for _ in range(_TRIALS):
            weight = 1 - weight
            time.sleep(_PERIOD_SECONDS * random.random())
            previous, expected = settled.means[1 - weight], settled.means[weight]
            step = np.where(expected == previous, 1, expected - previous)
            fraction = (cell_means(weight, wait) - previous) / step
            if (fraction < 1 - settled.allowed).any():
                smallest = float(fraction[np.isfinite(settled.allowed)].min())
                worst = min(worst, smallest, 1 - _TOLERANCE)
            time.sleep(settled.wait)
        fractions[wait] = worst
        return worst == 1

    high, low = 0.0, 0.0
    while high <= LONGEST_SECONDS and not is_sufficient(high):
        low, high = high, max(1 / 128, 2 * high)
    while low < high <= LONGEST_SECONDS and high - low > max(0.002, 0.1 * high):
        middle = (high + low) / 2
        high, low = (middle, low) if is_sufficient(middle) else (high, middle)
    return Delay(high, low, fractions)


def _findings(context: StepContext, delay: Delay) -> Findings:
    """Compare the delay with the projector's own wait."""
    waits = sorted(delay.worst)
    arrays = {"waits": np.array(waits), "worst": np.array([delay.worst[wait] for wait in waits])}
    settle = getattr(context.projector, "settle_seconds", 0.0)
    facts: dict[str, Any] = {"settle_seconds": settle, "trials": _TRIALS * len(waits)}
    if delay.sufficient > LONGEST_SECONDS:
        facts["unsettled_seconds"] = delay.insufficient
    else:
        facts |= {
            "delay_seconds": delay.sufficient,
            "delay_ms": 1000 * delay.sufficient,
            "proposed_settle_seconds": round(1.25 * delay.sufficient + _PERIOD_SECONDS, 3),
            "short_seconds": delay.sufficient - settle,
        }
    return Findings.of("latency", facts, arrays)


class Settled(NamedTuple):
    """Settled light of black and white.

    Attributes
    ----------
    means : ndarray of float64, shape (2, cells)
        Counts of black and white.
    wait : float
        Seconds after which the light has settled.
    allowed : ndarray of float64, shape (cells,)
        Accepted deviation relative to the step, infinite where the step is hardly visible.
    """

    means: Double
    wait: float
    allowed: Double


def _settled(cell_means: CellMeans) -> Settled | None:
    """Measure black and white twice, with longer waits until they agree; None if they never do."""
    wait = 0.2
    while wait <= LONGEST_SECONDS:
        black, white, second_white, second_black = (
            cell_means(weight, wait) for weight in (0, 1, 1, 0)
        )
        means = np.array([black + second_black, white + second_white]) / 2
        difference = np.abs([black - second_black, white - second_white])
        step = np.abs(means[1] - means[0])
        if difference.max() < _TOLERANCE * step.max():
            allowed = _TOLERANCE + 6 * difference.mean(axis=1).max() / np.maximum(step, 1e-9)
            return Settled(means, wait, np.where(step >= 0.1 * step.max(), allowed, np.inf))
        wait *= 2
    return None
