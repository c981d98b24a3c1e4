"""Verification pictures of a run, and check pictures during its captures."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.rigs.displaced_rigs import SHAPE, Knocked, beside, wedge
from tests.workflow.harness import Workflow
from tests.workflow.stagewise import CODE, SETTINGS, FaultyRig
from tests.workflow.stagewise import acquire as acquire_matrix

from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig
from rfpipe.stages import verification
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.storage.base import VERIFICATION, VERIFICATION_MANIFEST
from rfpipe.storage.checking import check
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.retake import find_retakes
from rfpipe.store import read_manifest
from rfpipe.units import CHECK_PICTURE_KEY, VERIFICATION_KEY

PICTURES = 4
INTERVAL = 8


def settings(mode: str = "warn", interval: int = INTERVAL, code: str = CODE) -> Any:
    return replace(
        SETTINGS,
        code=code,
        all_on_brackets=8,
        batch_patterns=1,
        watch=mode,
        check_interval=interval,
    )


def acquire(
    path: Path, rig: Any, method: str = "dual", mode: str = "warn", interval: int = INTERVAL
) -> FolderStorage:
    options = {"tolerance": 1e-2} if method == "dual" else {}
    plan = Plan.of(method, method, (SHAPE, SHAPE, 1), options)
    return acquire_matrix(path, rig, plan, settings(mode, interval))


def verified(folder: FolderStorage, rig: Any, code: str = CODE) -> dict[str, Any]:
    context = CaptureContext(folder, settings(code=code), rig_source=GivenRig(rig))
    verification.run(context, PICTURES)
    return read_manifest(folder.path / VERIFICATION_MANIFEST)


class Stopping(FaultyRig):
    """A rig that fails at a key, and records the keys of all pictures."""

    def __init__(self) -> None:
        super().__init__(OperatorRig(list(wedge()), SHAPE, SHAPE, CameraModel()), self._stop)
        self.stops_at: tuple[int, ...] | None = None

    def _stop(self, key: tuple[int, ...], frame: Any) -> Any:
        if key == self.stops_at:
            raise KeyboardInterrupt
        return frame


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("intact") / "results/matrix/dual"
    rig = Stopping()
    return verified(acquire(folder, rig, interval=0), rig)


def test_an_interrupted_verification_ends_with_the_same_numbers(
    tmp_path: Path, intact: dict[str, Any]
) -> None:
    rig = Stopping()
    folder = acquire(tmp_path / "results/matrix/dual", rig, interval=0)
    rig.shown.clear()
    rig.stops_at = (VERIFICATION_KEY, 2)
    with pytest.raises(KeyboardInterrupt):
        verified(folder, rig)
    rig.stops_at = None
    facts = verified(folder, rig)
    pictures = [key for key in rig.shown if key[0] == VERIFICATION_KEY]
    assert pictures == [(VERIFICATION_KEY, index) for index in range(PICTURES)]  # none is repeated
    assert facts == intact
    assert check(tmp_path / "results").findings == []
    shown = len(rig.shown)
    (folder.path / VERIFICATION_MANIFEST).unlink()
    assert verified(folder, rig, "other code")["pictures"] == intact["pictures"]
    assert len(rig.shown) == shown  # the pictures persist


def test_damage_of_a_verification_is_found(tmp_path: Path) -> None:
    rig = Stopping()
    folder = acquire(tmp_path / "results/matrix/dual", rig, interval=0)
    verified(folder, rig)
    store = folder.store(VERIFICATION, "capture")
    chunk = next(path for path in store.rglob("c*") if path.is_file())
    chunk.write_bytes(chunk.read_bytes()[:10])
    (tmp_path / "results/matrix/dual/verification.json").write_text("{")
    places = {finding.path.name for finding in check(tmp_path / "results").findings}
    assert {"capture.zarr", "verification.json"} <= places


@pytest.mark.parametrize("at", [3, 12])
def test_a_knock_ends_the_capture_within_ten_patterns(
    tmp_path: Path, at: int, caplog: pytest.LogCaptureFixture
) -> None:
    rig = Knocked(wedge(), beside(wedge(), 0.5), at, CameraModel())
    folder = tmp_path / "results" / "wedge" / "refused"
    for _ in range(2):  # the next run takes no pattern more
        with pytest.raises(CaptureError, match=r"moved.*start over: 'rfpipe run") as caught:
            acquire(folder, rig, mode="refuse")
        assert at < len(rig.keys) <= at + 10
    rig.at = 10**6  # put back
    name = re.search(r"Or put back .*--retake (\S+)'", str(caught.value))[1]
    for retake in find_retakes(tmp_path / "results", [name]):
        retake.set_aside()
    facts = verified(acquire(folder, rig, mode="refuse"), rig)
    assert facts["alarms"] == []
    assert facts["mean_error"] < 0.01
    rig = Knocked(wedge(), beside(wedge(), 0.5), at, CameraModel())
    with caplog.at_level(logging.WARNING):
        facts = verified(acquire(tmp_path / "warned", rig), rig)
    assert facts["moved"] > 0.1
    assert any("moved" in alarm for alarm in facts["alarms"])
    assert facts["mean_error"] > 0.05
    assert "the rig or the scene moved" in caplog.text


def test_a_passing_disturbance_does_not_end_the_capture(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    numbers = count()  # the first that is compared is the third

    def passing(key: tuple[int, ...], frames: np.ndarray) -> np.ndarray:
        return frames[:, ::-1] if key[0] == CHECK_PICTURE_KEY and next(numbers) == 2 else frames

    rig = FaultyRig(OperatorRig(list(wedge()), SHAPE, SHAPE, CameraModel()), passing)
    with caplog.at_level(logging.WARNING):
        acquire(tmp_path, rig, mode="refuse")
    assert "its repeat looks normal" in caplog.text


def test_a_steady_rig_gives_no_alarm(tmp_path: Path) -> None:
    rig = Stopping()
    facts = verified(acquire(tmp_path, rig, mode="refuse"), rig)
    assert facts["moved"] < 0.02
    assert facts["alarms"] == []
    check_keys = [key for key in rig.shown if key[0] == CHECK_PICTURE_KEY]
    patterns = [key for key in rig.shown if key[0] < 1000]
    n_levels = len({key[0] for key in patterns})
    assert len(check_keys) <= len(patterns) / INTERVAL + 2 * n_levels + 2


@pytest.mark.slow
def test_the_workflow_has_a_step_for_verification(tmp_path: Path) -> None:
    run = Workflow(tmp_path)
    scene = {"kind": "wedge", "surfaces": ["white", "texture"], "shape": [8, 8]}
    verification = {"pictures": 5, "fail_above": 1e-5}
    settings = {"scenes": {"tiny": scene}, "methods": {"symmetric": {}}}
    run.configure(**settings, verification=verification)
    target = "results/tiny/symmetric/verification.json"
    assert "verified by 5 pictures: the mean error is" in run.run(target)
    facts = read_manifest(tmp_path / target)
    assert np.isfinite([picture["error"] for picture in facts["pictures"]]).all()
    planned = run.run("--dry-run")
    # the message about errors above the bound follows the report
    assert re.search(r"^bound +1$", planned, re.MULTILINE)
    assert "verification " not in planned
    run.configure(**settings, verification={**verification, "fail_above": 0.5})
    assert "Nothing to be done" in run.run(target)  # a changed bound takes no pictures
