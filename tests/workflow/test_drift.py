"""A lamp that changes during a capture: detection, report, correction, and warm-up."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.workflow.stagewise import CAMERA, RAYS, StagewiseAcquisition, matrix_rig

from rfpipe.errors import CaptureError
from rfpipe.references.check_pictures import check_positions
from rfpipe.rigs import OperatorRig
from rfpipe.stages import capture
from rfpipe.stages.plan import Plan
from rfpipe.store import PictureStore
from rfpipe.units import CHECK_PICTURE_KEY, WARM_UP_KEY

EVERY = 3
WATCHING = {"watch": "warn", "check_interval": EVERY}


class DimmingRig:
    """A rig whose lamp dims from pattern to pattern of a level, and that may stop at a pattern."""

    def __init__(self, rig: OperatorRig, loss: float = 0.2) -> None:
        self._rig = rig
        self._loss = loss
        self.keys: list[tuple[int, ...]] = []
        self.stops_at: tuple[int, ...] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rig, name)

    def brightness(self, key: tuple[int, ...]) -> float:
        if key[0] == CHECK_PICTURE_KEY:
            return 1 - self._loss * min(key[2] * EVERY, RAYS) / RAYS
        return 1 - self._loss * (key[1] + 0.5) / RAYS if key[0] == 1 else 1.0

    def capture(self, patterns: Any, keys: Any) -> Any:
        if self.stops_at in keys:
            raise CaptureError("the lamp is broken")
        self.keys += keys
        dimmed = [
            pattern * np.float32(self.brightness(key))
            for pattern, key in zip(patterns, keys, strict=True)
        ]
        return self._rig.capture(np.reshape(dimmed, patterns.shape), keys)


def begun(path: Path, loss: float = 0.2) -> StagewiseAcquisition:
    """Return an acquisition whose next stage is the capture of level 1."""
    acquisition = StagewiseAcquisition(path, DimmingRig(matrix_rig(noise=CAMERA), loss))
    acquisition.plan = Plan.of("symmetric", "symmetric", ((4, 5), (4, 5), 1), {"tolerance": 1e-6})
    acquisition.level(0)
    acquisition.schedule(1)
    return acquisition


@pytest.fixture
def every_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Show one pattern per ray on level 1, enough for the lamp to change."""
    from rfpipe.methods.symmetric import method as symmetric
    from rfpipe.patterns import Schedule

    def one_ray_each(_self: Any, state: Any) -> Schedule:
        if state.level == 0:
            return Schedule.floodlit((4, 5))
        return Schedule(
            1, (4, 5), RAYS, pattern_of_ray=np.arange(RAYS, dtype=np.int32).reshape(4, 5)
        )

    monkeypatch.setattr(symmetric.Symmetric, "next_schedule", one_ray_each)


def images(acquisition: StagewiseAcquisition) -> np.ndarray:
    with acquisition.folder.pictures(1, "merge") as frames:
        return frames.read(0, RAYS)[:, 0]


pytestmark = pytest.mark.usefixtures("every_ray")


def test_the_loss_of_the_lamp_is_measured_and_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    acquisition = begun(tmp_path)
    with caplog.at_level(logging.INFO):
        acquisition.capture(1, **WATCHING)
    acquisition.merge(1)
    drift = acquisition.folder.read_manifest(1, "merge")["check_pictures"]
    expected = [1 - 0.2 * position / RAYS for position in check_positions(RAYS, EVERY)]
    noise = np.array(drift["deviation"])
    assert 1e-4 < noise.max() < 0.02
    assert np.abs(np.array(drift["gain"])[:, 0] - expected).max() < 4 * noise.max()
    assert "the lamp's light changed by" in caplog.text
    assert "merge.divide_out_drift" in caplog.text
    steady = begun(tmp_path / "steady", loss=0.0)
    with caplog.at_level(logging.INFO):
        steady.capture(1, **WATCHING)
        steady.merge(1)
    assert steady.folder.read_manifest(1, "merge")["check_pictures"]["change"] == [0.0] * (
        RAYS // EVERY + 1
    )


def test_corrected_images_equal_those_of_a_steady_lamp(tmp_path: Path) -> None:
    steady, dimming = begun(tmp_path / "steady", loss=0.0), begun(tmp_path / "dimming")
    for acquisition in (steady, dimming):
        acquisition.capture(1, **WATCHING)
        acquisition.merge(1)
    expected, uncorrected = images(steady), images(dimming)
    dimming.merge(1, divide_out_drift=True)
    corrected = images(dimming)
    late = slice(RAYS // 2, None)
    assert uncorrected[late].sum() < 0.9 * expected[late].sum()
    assert corrected[late].sum() == pytest.approx(expected[late].sum(), rel=0.01)
    assert corrected.sum() == pytest.approx(expected.sum(), rel=0.01)


@pytest.mark.parametrize("stops_at", [(1, 4), (CHECK_PICTURE_KEY, 1, 2), (CHECK_PICTURE_KEY, 1, 6)])
def test_an_interrupted_watched_capture_ends_with_the_same_bytes(
    tmp_path: Path, stops_at: tuple[int, ...]
) -> None:
    # for a slowly drifting lamp check pictures aren't repeated
    uninterrupted, stopped = begun(tmp_path / "whole", 0.05), begun(tmp_path / "stopped", 0.05)
    stopped.rig.stops_at = stops_at
    with pytest.raises(CaptureError, match="broken"):
        stopped.capture(1, **WATCHING, batch_patterns=2)
    stopped.rig.stops_at = None
    for acquisition in (uninterrupted, stopped):
        acquisition.capture(1, **WATCHING)
        acquisition.merge(1, divide_out_drift=True)
    assert len(set(stopped.rig.keys)) == len(stopped.rig.keys)  # no picture is repeated
    manifests = [
        acquisition.folder.read_manifest(1, "merge") for acquisition in (uninterrupted, stopped)
    ]
    assert manifests[0]["digest"] == manifests[1]["digest"]
    assert manifests[0]["check_pictures"] == manifests[1]["check_pictures"]


def test_a_level_begun_without_check_pictures_continues_without_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    acquisition = begun(tmp_path)
    acquisition.rig.stops_at = (1, 4)
    with pytest.raises(CaptureError, match="broken"):
        acquisition.capture(1, batch_patterns=2)
    acquisition.rig.stops_at = None
    acquisition.capture(1, **WATCHING)
    assert "check_pictures" not in acquisition.folder.read_manifest(1, "capture")
    acquisition.merge(1, divide_out_drift=True)
    assert "check_pictures" not in acquisition.folder.read_manifest(1, "merge")


def test_a_changed_interval_does_not_affect_a_level_already_begun(tmp_path: Path) -> None:
    acquisition = begun(tmp_path)
    acquisition.capture(1, **WATCHING)
    n_pictures = len(acquisition.rig.keys)
    for every in (0, 10 * EVERY):
        acquisition.capture(1, watch=WATCHING["watch"], check_interval=every)
        assert acquisition.folder.read_manifest(1, "capture")["check_pictures"]["interval"] == EVERY
    assert len(acquisition.rig.keys) == n_pictures


def test_the_lamp_warms_up_when_it_may_have_been_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(capture, "_SECONDS_BETWEEN_BRACKETS", 0.02)
    acquisition = StagewiseAcquisition(tmp_path, DimmingRig(matrix_rig(noise=CAMERA)))
    acquisition.schedule(0)
    with caplog.at_level(logging.INFO):
        acquisition.capture(0, warm_up_minutes=0.1 / 60)
    shown = [key for key in acquisition.rig.keys if key[0] == WARM_UP_KEY]
    assert 2 <= len(shown) <= 6
    assert acquisition.rig.keys[: len(shown)] == shown
    with PictureStore.open(acquisition.folder.store(0, "capture")) as frames:
        assert frames.shape[0] == 1
    for stage in (
        acquisition.merge,
        acquisition.normalize,
        acquisition.refine,
        acquisition.schedule,
    ):
        stage(1 if stage == acquisition.schedule else 0)
    n_pictures = len(acquisition.rig.keys)
    acquisition.capture(1, warm_up_minutes=60)  # it was on a moment ago
    assert not [key for key in acquisition.rig.keys[n_pictures:] if key[0] == WARM_UP_KEY]
