"""Disk space: estimated and checked before a rig is opened."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.workflow.stagewise import (
    CAMERA,
    RAYS,
    SHAPE,
    FaultyRig,
    StagewiseAcquisition,
    matrix_rig,
)

from rfpipe.errors import StoreError
from rfpipe.rigs import OperatorRig
from rfpipe.stages.forecast import disk_bytes
from rfpipe.stages.plan import Plan
from rfpipe.store import bytes_on_disk

Disk = Callable[[int], None]


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    """Set the free bytes of every file system."""

    def has_free(free: int) -> None:
        usage = SimpleNamespace(free=free)
        monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage)

    return has_free


def acquisition(folder: Path, **settings: Any) -> StagewiseAcquisition:
    rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    acquisition = StagewiseAcquisition(folder, rig, **settings)
    acquisition.plan = Plan.of("brute_force", "brute_force", (SHAPE, SHAPE, 1))
    acquisition.schedule(0)
    return acquisition


NEED = disk_bytes(CAMERA, SHAPE, 1, 2 + 2 + RAYS, RAYS)


def test_the_estimate_bounds_the_disk_space_of_a_level(tmp_path: Path) -> None:
    stagewise = acquisition(tmp_path)
    before = bytes_on_disk(tmp_path)
    for stage in (stagewise.capture, stagewise.merge, stagewise.normalize):
        stage(0)
    metadata = sum(path.stat().st_size for path in tmp_path.rglob("*.json*"))
    assert bytes_on_disk(tmp_path) - before < NEED + 2 * metadata


def test_a_capture_that_does_not_fit_is_refused_before_the_rig_is_touched(
    tmp_path: Path, disk: Disk, caplog: pytest.LogCaptureFixture
) -> None:
    stagewise = acquisition(tmp_path)
    disk(NEED - 1)
    with pytest.raises(StoreError) as error:
        stagewise.capture(0)
    message = str(error.value)
    assert str(tmp_path) in message
    assert f"up to {NEED / 1e6:.3g} MB" in message
    for advice in ("another disk", "capture.keep_raw to false", "the method's options"):
        assert advice in message
    assert stagewise.rig.shown == []

    disk(NEED)
    with caplog.at_level(logging.INFO, logger="rfpipe"):
        stagewise.capture(0)
    assert len(stagewise.rig.shown) == 4 + RAYS
    assert f"level 0: takes up to {NEED / 1e6:.3g} MB" in caplog.text

    disk(0)  # nothing to capture, so nothing to refuse
    stagewise.capture(0)


def test_only_missing_items_are_counted(tmp_path: Path, disk: Disk) -> None:
    stagewise = acquisition(tmp_path)

    def stops(key: tuple[int, ...], frame: Any) -> Any:
        if key == (0, 7):
            raise KeyboardInterrupt
        return frame

    stagewise.rig = FaultyRig(matrix_rig(noise=CAMERA), stops)
    with pytest.raises(KeyboardInterrupt):
        stagewise.capture(0, batch_patterns=1)
    stagewise.rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    needed = disk_bytes(CAMERA, SHAPE, 1, RAYS - 7, RAYS)
    disk(needed - 1)
    with pytest.raises(StoreError, match="isn't begun"):
        stagewise.capture(0)
    disk(needed)
    stagewise.capture(0)
    assert stagewise.rig.shown == [(0, index) for index in range(7, RAYS)]

    # a repeated capture overwrites its merged images
    stagewise.merge(0)
    stagewise.rig = OperatorRig(matrix_rig()._operator, SHAPE, SHAPE, CAMERA, seed=9)
    present = bytes_on_disk(tmp_path / "L00/merge.zarr")
    disk(NEED - present - 1)
    with pytest.raises(StoreError, match="are used already"):
        stagewise.capture(0)
    disk(NEED - present)
    stagewise.capture(0)
