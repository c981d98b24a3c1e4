"""The stages on files, called as functions: failing rigs, and stale or damaged stores."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.workflow.stagewise import (
    CAMERA,
    RAYS,
    SHAPE,
    FaultyRig,
    StagewiseAcquisition,
    contents,
    matrix_rig,
    symmetric_matrix,
)

from rfpipe import acquire
from rfpipe.errors import CaptureError, StaleStoreError
from rfpipe.jobs.workers import Resources
from rfpipe.rigs import OperatorRig
from rfpipe.stages.plan import Plan
from rfpipe.store import read_manifest


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda frame: np.full_like(frame, np.nan), "pattern 3: the rig returned NaN"),
        (lambda frame: frame[:, :-1], r"pattern 3: the rig returned .*\(1, 3, 5, 1\)"),
        (lambda frame: frame.astype(np.float64), "pattern 3: the rig returned float64"),
    ],
    ids=["nan", "size", "dtype"],
)
def test_invalid_frames_are_refused_and_captured_ones_persist(
    tmp_path: Path, fault: Callable[[Any], Any], message: str
) -> None:
    broken = FaultyRig(matrix_rig(), lambda key, frame: fault(frame) if key == (1, 3) else frame)
    acquisition = StagewiseAcquisition(tmp_path, broken)
    acquisition.level(0)
    acquisition.schedule(1)
    with pytest.raises(CaptureError, match=message):
        acquisition.capture(1, batch_patterns=1)
    assert not (tmp_path / "L01/capture.json").exists()

    mended = FaultyRig(matrix_rig(), lambda key, frame: frame)
    acquisition.rig = mended
    acquisition.capture(1)
    assert mended.shown == [(1, 3)]  # frames 0 to 2 are stored


def test_negative_frames_are_refused_by_the_merge(tmp_path: Path) -> None:
    rig = FaultyRig(matrix_rig(), lambda key, frame: -frame if key == (1, 2) else frame)
    acquisition = StagewiseAcquisition(tmp_path, rig)
    acquisition.level(0)
    acquisition.schedule(1)
    acquisition.capture(1)
    with pytest.raises(CaptureError, match="pattern 2 holds -"):
        acquisition.merge(1)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda key, frame: np.full_like(frame, 64), "all black"),
        (
            lambda key, frame: np.full_like(frame, 200) if key[0] == 1_000_000 else frame,
            "black level is above the signal",
        ),
        (
            lambda key, frame: np.full_like(frame, 4095) if key[0] == 1_000_001 else frame,
            "100.0% of the floodlit image is saturated",
        ),
    ],
    ids=["black", "dark", "saturated"],
)
def test_a_floodlit_image_without_light_stops_the_run(
    tmp_path: Path, fault: Callable[[tuple[int, ...], Any], Any], message: str
) -> None:
    dim = matrix_rig(1e-6 * symmetric_matrix(), CAMERA)
    acquisition = StagewiseAcquisition(tmp_path, FaultyRig(dim, fault))
    acquisition.schedule(0)
    acquisition.capture(0)
    with pytest.raises(CaptureError, match=message):
        acquisition.merge(0)


def test_saturated_samples_are_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def glint(key: tuple[int, ...], frame: Any) -> Any:
        if key == (0, 0):
            frame[:, 0, :3] = 4095
        return frame

    acquisition = StagewiseAcquisition(tmp_path, FaultyRig(matrix_rig(noise=CAMERA), glint))
    acquisition.schedule(0)
    acquisition.capture(0)
    with caplog.at_level(logging.WARNING, logger="rfpipe"):
        acquisition.merge(0)
    manifest = read_manifest(tmp_path / "L00/merge.json")
    assert (manifest["saturated"], manifest["samples"]) == (3, RAYS)
    assert "3 of 20 samples are saturated in every exposure" in caplog.text


def test_a_changed_rig_is_refused_or_captured_again_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    acquisition = StagewiseAcquisition(tmp_path, matrix_rig(noise=CAMERA))
    acquisition.level(0)
    first = read_manifest(tmp_path / "L00/capture.json")
    acquisition.rig = OperatorRig(symmetric_matrix(), SHAPE, SHAPE, CAMERA, seed=7)
    with pytest.raises(StaleStoreError, match=r"4 captured patterns.*\(rig\.seed 0 -> 7\)"):
        acquisition.capture(0, when_patterns_change="refuse")

    with caplog.at_level(logging.INFO, logger="rfpipe"):
        acquisition.capture(0)
    messages = [record.getMessage() for record in caplog.records]
    recaptured = next(i for i, text in enumerate(messages) if "CAPTURING AGAIN" in text)
    assert "rig.seed 0 -> 7" in messages[recaptured]
    assert all("patterns in" not in text for text in messages[:recaptured])  # before the capture
    assert read_manifest(tmp_path / "L00/capture.json")["digest"] != first["digest"]

    acquisition.rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    acquisition.capture(0, when_patterns_change="refuse")
    assert acquisition.rig.shown == []  # the earlier pictures are used
    assert read_manifest(tmp_path / "L00/capture.json") == first


def test_the_duration_of_pictures_changes_no_frame(tmp_path: Path) -> None:
    acquisition = StagewiseAcquisition(tmp_path, matrix_rig())
    acquisition.level(0)
    slow = OperatorRig(symmetric_matrix(), SHAPE, SHAPE, seconds_per_pattern=9.0)
    acquisition.rig = FaultyRig(slow, lambda key, frame: frame)
    acquisition.capture(0, when_patterns_change="refuse")
    assert acquisition.rig.shown == []


def test_a_memory_limit_reduces_the_patterns_per_batch(tmp_path: Path) -> None:
    batches = []

    class Counting(OperatorRig):
        def capture(self, patterns: Any, keys: Any) -> Any:
            batches.append(len(keys))
            return super().capture(patterns, keys)

    rig = Counting(symmetric_matrix(), SHAPE, SHAPE, CAMERA)
    acquisition = StagewiseAcquisition(tmp_path, rig)
    acquisition.plan = Plan.of("brute_force", "brute_force", (SHAPE, SHAPE, 1))
    acquisition.schedule(0)
    acquisition.capture(0, batch_patterns=3)
    assert max(batches) == 3
    before = contents(tmp_path / "L00/capture.zarr")
    batches.clear()
    repeated = StagewiseAcquisition(tmp_path / "again", rig)
    repeated.plan, repeated.resources = acquisition.plan, Resources(memory_gib=1e-6)
    repeated.schedule(0)
    repeated.capture(0, batch_patterns=3)
    assert batches == [1] * (2 + 2 + RAYS)
    assert contents(tmp_path / "again/L00/capture.zarr") == before


@pytest.mark.parametrize(
    ("failure", "message", "shows_where"),
    [
        ("raise CaptureError('no light; switch it on')", "no light; switch it on", False),
        ("signal.raise_signal(signal.SIGTERM)", "stopped; finished work is kept", False),
        ("signal.raise_signal(signal.SIGINT)", "stopped; finished work is kept", False),
        ("1 / 0", "ZeroDivisionError", True),
    ],
)
def test_a_job_reports_why_it_ends_early(
    tmp_path: Path, failure: str, message: str, shows_where: bool
) -> None:
    log = tmp_path / "planes_i" / "dual" / "L02" / "merge.log"
    lines = [
        "import signal",
        "from rfpipe.errors import CaptureError",
        "from rfpipe.jobs.job import start",
        f"start({str(log)!r})",
        failure,
    ]
    ended = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False
    )
    assert ended.returncode != 0
    assert message in ended.stderr
    assert ("Traceback" in ended.stderr) == shows_where
    assert message in log.read_text()
    if "CaptureError" in failure:
        assert ended.stderr == f"planes_i/dual/L02/merge: {message}\n"
        assert "Traceback" in log.read_text()


def test_a_stage_runs_without_a_writable_log() -> None:
    code = "from rfpipe.jobs.job import start, _log; start('/dev/full'); _log.warning('for it')"
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert "for it" in output.stderr
    assert "No space left" not in output.stderr


@pytest.mark.parametrize("method", ["symmetric", "dual", "brute_force"])
def test_files_equal_the_result_in_process_with_hot_pixels(tmp_path: Path, method: str) -> None:
    def heated(_: tuple[int, ...], frames: Any) -> Any:
        frames[:, 1, 2] = frames[:, 3, 4] = 3000
        return frames

    rig = FaultyRig(matrix_rig(noise=CAMERA), heated)
    acquisition = StagewiseAcquisition(tmp_path, rig, None, method)
    acquisition.acquire_levels()
    stored = acquisition.assemble()
    result = acquire(rig, method, progress=False, all_off_brackets=2, all_on_brackets=2)
    assert np.argwhere(result.masked).tolist() == [[1, 2], [3, 4]]
    assert read_manifest(tmp_path / "transport.json")["masked"] == 2
    impulses = np.eye(RAYS, dtype=np.float32).reshape(RAYS, *SHAPE)
    images = stored.relight_batch(impulses)
    np.testing.assert_array_equal(images, result.transport.relight_batch(impulses))
    matrix = images.reshape(RAYS, RAYS).T
    hot = result.masked.ravel()
    assert matrix[np.ix_(hot, ~hot)].all()
    np.testing.assert_allclose(matrix[np.ix_(hot, ~hot)], matrix[np.ix_(~hot, hot)].T, rtol=1e-5)
