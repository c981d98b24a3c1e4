"""Delay, frames and light of a rig in words, for `rfpipe aim`, with the faults of a bench."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.rigs.calibration_bench import CAMERA, brighter, wedge_bench

from rfpipe.calibration import context as context_module
from rfpipe.calibration import latency
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.synchronisation import measure_synchronisation
from rfpipe.calibration.verdicts import Verdict
from rfpipe.config import CalibrationConfig
from rfpipe.testing import faults


class SlowProjector:
    """A projector whose picture appears after a delay, by a simulated clock.

    `settle_seconds` is the time for which `show` waits.
    """

    def __init__(self, projector: Any, clock: SimpleNamespace, delay: float, settle: float) -> None:
        self._projector, self._clock, self._delay = projector, clock, delay
        self.shape, self.settle_seconds = projector.shape, settle
        self._pending: list[tuple[float, np.ndarray]] = []

    def show_now(self, picture: np.ndarray) -> None:
        self._pending.append((self._clock.now + self._delay, picture))

    def show(self, picture: np.ndarray) -> None:
        self.show_now(picture)
        self._clock.sleep(self.settle_seconds)

    def update(self) -> None:
        """Display the pictures whose delay has passed."""
        while self._pending and self._pending[0][0] <= self._clock.now:
            self._projector.show(self._pending.pop(0)[1])


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    clock = SimpleNamespace(now=0.0)

    def sleep(seconds: float) -> None:
        clock.now += seconds

    clock.sleep = sleep
    for module in (latency, context_module):
        monkeypatch.setattr(module, "time", clock)
    return clock


def measured(
    clock: SimpleNamespace,
    inject: Callable[[Any], Any] = lambda camera: camera,
    delay: float = 0.0,
    settle: float = 0.1,
) -> dict[str, Verdict]:
    bench = wedge_bench((12, 12), (96, 96), (40, 42), sensor=brighter(CAMERA, 0.5))
    projector = SlowProjector(bench.projector, clock, delay, settle)
    expose = bench.camera.expose

    def expose_later() -> Any:
        projector.update()
        return expose()

    bench.camera.expose = expose_later  # type: ignore[method-assign]
    settings = CalibrationConfig(period_pixels=16)
    rig: Any = projector, inject(bench.camera), settings, None, {}, lambda _: nullcontext()
    return measure_synchronisation(StepContext(*rig))


def losing(camera: Any) -> Any:
    """Return a camera that lost frames, according to its counters."""
    camera.statistics = {"frames": 1995, "failed": 2, "timed_out": 3, "reconnected": 0}
    return camera


NONE_LOST = r"All 48 frames show their own picture; none was lost\."
STEADY = r"picture to picture, at exposures of 15\.6 ms by at most 0\.\d%, .* by at most \d\.\d%\.$"
FLICKER = (
    r"exposures of 15\.6 ms by 1\d\.\d%, of 62\.5 ms by \d\.\d%, .* by at most .* The lamp "
    r"flickers, .*take exposures of whole periods, .*\[0\.02, .* 50 Hz"
)
GOOD = {
    "delay": ("good", "0 ms after"),
    "frames": ("good", NONE_LOST),
    "light": ("good", STEADY),
}
SLOW = ("good", r"(8|9|10)\d? ms after it was drawn, in all")
SETTLE = ("poor", r"waits for 0\.01 s only.*Set projector\.options\.settle_seconds to 0\.1")
LATE = ("poor", "In 100% of the changes .* previous picture: empty the camera's queue")

CASES: dict[str, tuple[dict[str, Any], dict[str, tuple[str, str]]]] = {
    "none": ({}, GOOD),
    "slow": ({"delay": 0.09}, {**GOOD, "delay": SLOW}),
    "settle": ({"delay": 0.09, "settle": 0.01}, {**GOOD, "delay": SETTLE}),
    "late": ({"inject": faults.LateCamera}, {"frames": LATE, "light": ("unknown", "until")}),
    "repeated": (
        {"inject": faults.RepeatingCamera},
        {"frames": ("poor", r"\d of 12 brackets contain a frame of the bracket before")},
    ),
    "lost": (
        {"inject": losing},
        {"frames": ("poor", "5 of 2000 frames since the start .* the camera's cable")},
    ),
    "flicker": ({"inject": faults.flickering_lamp}, {"light": ("poor", FLICKER)}),
    "gain": (
        {"inject": faults.jittering_gain},
        {"delay": ("unknown", "until"), "light": ("poor", "gain changes .* automatic gain")},
    ),
    "covered": ({"delay": 1e9}, {"delay": ("failed", "lens is open")}),
}


@pytest.mark.parametrize("name", CASES)
def test_faults_are_described_with_their_remedy(name: str, clock: SimpleNamespace) -> None:
    options, expected = CASES[name]
    verdicts = measured(clock, **options)
    for part, (standing, text) in expected.items():
        assert verdicts[part].standing == standing, verdicts
        assert re.search(text, verdicts[part].text), verdicts
