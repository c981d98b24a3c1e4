"""Measurement of the delay from display to camera, and detection of too short settings."""

from contextlib import closing, nullcontext

import numpy as np
import pytest
from tests.device.test_bench import RAYS, bench, settings

from rfpipe.calibration import latency
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.latency import PICTURES, measure_latency
from rfpipe.config import CalibrationConfig
from rfpipe.errors import CaptureError
from rfpipe.rigs.build import devices_from_config

pytestmark = pytest.mark.slow


def measured(delay: float, settle: float, *, is_covered: bool = False):  # type: ignore[no-untyped-def]
    config = settings(
        bench={"display_delay_seconds": delay},
        projector={"options": {"settle_seconds": settle}},
    )
    projector, camera = devices_from_config(config)
    with closing(projector), closing(camera):
        if is_covered:
            projector.show_now = lambda picture: None  # type: ignore[attr-defined]
        context = StepContext(
            projector, camera, CalibrationConfig(), None, {}, lambda _: nullcontext()
        )
        return projector, measure_latency(context)


def test_a_quick_display_is_good() -> None:
    projector, result = measured(0, 0.1)
    assert result.verdict.standing == "good"
    assert result.facts["delay_seconds"] == 0
    assert result.facts["settle_seconds"] == 0.1
    assert projector.statistics["shown"] == PICTURES


def test_a_slow_display_is_found_with_the_setting_to_change() -> None:
    _, result = measured(0.1, 0.01)
    assert result.verdict.standing == "poor"
    assert 0.05 < result.facts["delay_seconds"] < 0.2
    proposed = result.facts["proposed_settle_seconds"]
    assert f"projector.options.settle_seconds to {proposed:g}" in result.verdict.text
    assert proposed > result.facts["delay_seconds"]
    assert result.arrays["worst"][0] < 0.5 < result.arrays["worst"][-1] == 1


def test_a_covered_projector_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "LONGEST_SECONDS", 0.5)
    with pytest.raises(CaptureError, match="not brighter than black ones"):
        measured(0, 0, is_covered=True)


@pytest.mark.parametrize("exposures", [(1 / 64,), (1 / 64, 1 / 8)])
def test_pictures_of_the_previous_pattern_are_repeated(
    exposures: tuple[float, ...], caplog: pytest.LogCaptureFixture
) -> None:
    patterns = (np.random.default_rng(0).random((6, *RAYS)) < 0.5).astype(np.float32)
    keys = [(0, index) for index in range(6)]
    changes = {"sensor": {"exposures": exposures}}
    with bench(**changes) as quick:
        expected = quick.capture(patterns, keys).astype(float)
        assert quick.statistics["brackets"] == {"doubted": 0, "stale": 0, "unsteady": 0}
    with bench(**changes, bench={"display_delay_seconds": 0.03}) as slow:
        frames = slow.capture(patterns, keys).astype(float)
        assert slow.statistics["brackets"]["stale"] >= 4
    noise = np.abs(frames - expected).mean(axis=tuple(range(1, frames.ndim)))
    step = np.abs(expected[1:] - expected[:-1]).mean()
    assert (noise < 0.1 * step).all()
    assert "frames show the previous picture" in caplog.text
    assert "settle_seconds" in caplog.text
