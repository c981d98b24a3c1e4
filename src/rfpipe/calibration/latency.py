"""From display to camera: how long after a picture was drawn the camera sees it, and it alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Float, Measured, Verdict, uniform
from rfpipe.errors import CaptureError
from rfpipe.provenance import generator
from rfpipe.rigs.devices import Camera, Projector

__all__ = ["PICTURES", "Latency", "latency_findings", "measure_latency"]

Double = NDArray[np.float64]

SETTLED_SECONDS = 0.2
"""Wait for the pictures that others are compared with; doubles until they are alike."""

LONGEST_SECONDS = 4.0
"""Longest delay that is looked for."""

FIRST_WAIT_SECONDS = 1 / 128

TRIALS = 4
"""Pictures after each wait, black and white by turns, at any time of the display's period."""

PICTURES = 4 + TRIALS
"""Pictures shown where no wait is needed."""

RESOLUTION_SECONDS = 0.002
RELATIVE_RESOLUTION = 0.1

PERIOD_SECONDS = 0.02
"""A display's period, about: trials begin anywhere in it, and it is added to what is proposed."""

MARGIN = 0.25
"""Of the delay, added too."""

CELLS = 8
"""Cells along either side of the picture: a display that is drawn row by row is late in some."""

LIT = 0.1
"""Of the brightest cell's contrast: darker ones tell too little."""

OFF = 0.05
"""Share of the step that a cell may still lack."""

SIGNIFICANCE = 6.0


@dataclass(frozen=True)
class Latency(Measured):
    """What was seen after each wait.

    Attributes
    ----------
    delay_seconds : float or None
        Least wait after which all pictures were right; None where none was long enough.
    wrong_seconds : float or None
        Longest wait after which one was not; None where there was none.
    settle_seconds : float or None
        What the projector waits by its settings; None where that isn't known.
    waits : ndarray of float64, shape (n,)
        In seconds.
    worst : ndarray of float64, shape (n,)
        Of the trials and cells after each wait, the least share of the step that was seen: 1 for
        the new picture, 0 for the one before.
    """

    delay_seconds: float | None
    wrong_seconds: float | None
    settle_seconds: float | None
    waits: Double
    worst: Double

    @property
    def proposed_seconds(self) -> float | None:
        """What settle_seconds should be."""
        if self.delay_seconds is None:
            return None
        return round((1 + MARGIN) * self.delay_seconds + PERIOD_SECONDS, 3)


def measure_latency(projector: Projector, camera: Camera) -> Latency:
    """Switch between black and white, and see after which wait the first exposure is right.

    Raises
    ------
    CaptureError
        When a device fails, or white isn't told from black.
    """
    show: Callable[[Float], None] = getattr(projector, "show_now", projector.show)
    black, white = _settled(show, projector, camera)
    random = generator(0)
    found: dict[float, float] = {}
    is_white = False

    def worst_after(wait: float) -> float:
        nonlocal is_white
        worst = 1.0
        for _ in range(TRIALS):
            is_white = not is_white
            time.sleep(PERIOD_SECONDS * random.random())
            show(uniform(projector, float(is_white)))
            time.sleep(wait)
            seen = _cells(camera)
            here, before = (white, black) if is_white else (black, white)
            worst = min(worst, here.step_from(before, seen))
            time.sleep(white.settled_seconds)
        found[wait] = worst
        return worst

    right, wrong = 0.0, None
    while worst_after(right) < 1:
        wrong, right = right, max(FIRST_WAIT_SECONDS, 2 * right)
        if right > LONGEST_SECONDS:
            return _latency(None, wrong, projector, found)
    while wrong is not None and right - wrong > max(
        RESOLUTION_SECONDS, RELATIVE_RESOLUTION * right
    ):
        middle = (right + wrong) / 2
        right, wrong = (middle, wrong) if worst_after(middle) == 1 else (right, middle)
    return _latency(right, wrong, projector, found)


def latency_findings(latency: Latency, seconds_per_bracket: float) -> Findings:
    """Judge the settings' wait by the delay.

    Parameters
    ----------
    latency : Latency
    seconds_per_bracket : float
        Sum of the exposures, to tell what a shorter wait would save.
    """
    delay, settle, proposed = (
        latency.delay_seconds,
        latency.settle_seconds,
        latency.proposed_seconds,
    )
    facts = {"proposed_settle_seconds": proposed}
    if delay is None or proposed is None:
        text = (
            f"Even {latency.wrong_seconds:g} s after a picture was drawn, the camera didn't see it "
            "wholly. Does the lamp flicker, or change with the picture (dynamic contrast, eco "
            "mode)? Switch that off, and calibrate again."
        )
        return latency.findings(Verdict("poor", text), **facts)
    until = f"{1000 * delay:.0f} ms after it was drawn" if delay else "at once"
    seen = f"A picture is seen {until}, in all of {TRIALS * len(latency.waits)} trials"
    if settle is None:
        if delay == 0:
            text = f"{seen}: the projector returns when its light has settled."
            return latency.findings(Verdict("good", text), **facts)
        text = (
            f"{seen}. The projector's driver returns before its light has settled: let its `show` "
            f"wait for {proposed:g} s more."
        )
        return latency.findings(Verdict("poor", text), **facts)
    if settle < delay:
        text = (
            f"{seen}, but projector.options.settle_seconds is {settle:g}: frames are taken of the "
            f"picture before. Set it to {proposed:g}, and calibrate again."
        )
        return latency.findings(Verdict("poor", text), **facts)
    text = f"{seen}; projector.options.settle_seconds is {settle:g}."
    if settle < proposed:
        text += f" {proposed:g} would leave room for a display that is slower at times."
    elif settle > 2 * proposed:
        share = (settle - proposed) / (settle + seconds_per_bracket)
        text += f" {proposed:g} would do, and save about {share:.0%} of a capture's time."
    return latency.findings(Verdict("good", text), **facts)


@dataclass(frozen=True)
class _Seen:
    """What the first exposure's cells show of a picture that has settled."""

    mean: Double
    deviation: Double
    settled_seconds: float

    def step_from(self, before: _Seen, seen: Double) -> float:
        """Return the least share of the step towards this picture, 1 where all is within noise."""
        step = self.mean - before.mean
        lit = np.abs(step) >= LIT * np.abs(step).max()
        share = (seen - before.mean)[lit] / step[lit]
        noise = SIGNIFICANCE * np.maximum(self.deviation, before.deviation)[lit] / np.abs(step[lit])
        least = float(share.min())
        return 1.0 if (share >= 1 - OFF - noise).all() else min(least, 1 - OFF)


def _settled(
    show: Callable[[Float], None], projector: Projector, camera: Camera
) -> tuple[_Seen, _Seen]:
    """Return what black and white look like, each seen twice alike."""
    wait = SETTLED_SECONDS
    while wait <= LONGEST_SECONDS:
        seen = []
        for weight in (0.0, 1.0, 1.0, 0.0):  # however late, it isn't the same
            show(uniform(projector, weight))
            time.sleep(wait)
            seen.append(_cells(camera))
        pairs = np.stack([seen[0], seen[3]]), np.stack([seen[1], seen[2]])
        black, white = (pair.mean(axis=0) for pair in pairs)
        apart = [np.ptp(pair, axis=0) for pair in pairs]
        if max(float(each.max()) for each in apart) < OFF * np.abs(white - black).max():
            noise = (np.full_like(each, each.mean()) for each in apart)
            return _Seen(black, next(noise), wait), _Seen(white, next(noise), wait)
        wait *= 2
    raise CaptureError(
        "the camera's shortest exposure doesn't tell a white picture from a black one. Is the lens "
        "open, does the projector light the scene, and is the exposure long enough?"
    )


def _cells(camera: Camera) -> Double:
    """Take a bracket; return the means of its first exposure over cells, (CELLS * CELLS,)."""
    frame = np.asarray(camera.expose())[0].astype(np.float64)
    rows, columns = (
        np.array_split(np.arange(extent), min(extent, CELLS)) for extent in frame.shape[:2]
    )
    return np.array([frame[np.ix_(row, column)].mean() for row in rows for column in columns])


def _latency(
    delay: float | None, wrong: float | None, projector: Projector, found: dict[float, float]
) -> Latency:
    waits = sorted(found)
    settle = getattr(projector, "settle_seconds", None)
    worst = np.array([found[wait] for wait in waits])
    return Latency(delay, wrong, settle, np.array(waits), worst)
