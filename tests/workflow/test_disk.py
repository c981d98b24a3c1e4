"""Disk space: estimated and checked before a rig is touched."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.workflow.stagewise import CAMERA, RAYS, SHAPE, Acquisition, FaultyRig, matrix_rig

from rfpipe.blocks import RayDomain
from rfpipe.errors import StoreError
from rfpipe.methods import get_method, options_of
from rfpipe.rigs import OperatorRig
from rfpipe.stages.capturing.disk import DiskNeed
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


def acquisition(folder: Path, **settings: Any) -> Acquisition:
    rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    found = Acquisition(folder, rig, **settings)
    found.plan = Plan("brute_force", "brute_force", SHAPE, SHAPE, 1)
    found.schedule(0)
    return found


NEED = DiskNeed.of(CAMERA, SHAPE, 1, 2 + 2 + RAYS, RAYS)


def test_the_estimate_bounds_what_a_level_takes(tmp_path: Path) -> None:
    mine = acquisition(tmp_path)
    before = bytes_on_disk(tmp_path)
    mine.capture(0)
    raw = bytes_on_disk(tmp_path) - before
    assert NEED.raw > 24 * 4 * RAYS * 2
    assert raw - 2 * 2048 < NEED.raw  # without both stores' metadata
    mine.merge(0)
    stored = sum(path.stat().st_size for path in (tmp_path / "L00/merge.zarr").glob("c.*"))
    assert stored < NEED.merged
    assert NEED.total == NEED.raw + NEED.merged + NEED.rest


def test_a_capture_that_does_not_fit_is_refused_before_the_rig_is_touched(
    tmp_path: Path, disk: Disk, caplog: pytest.LogCaptureFixture
) -> None:
    mine = acquisition(tmp_path)
    disk(NEED.total - 1)
    with pytest.raises(StoreError) as error:
        mine.capture(0)
    message = str(error.value)
    assert str(tmp_path) in message
    assert f"up to {NEED.total / 1e6:.3g} MB (raw exposures {NEED.raw / 1e6:.3g} MB" in message
    assert f"{NEED.total / 1e6:.3g} MB are free" in message
    for advice in ("another disk", "capture.keep_raw to false", "the method's options"):
        assert advice in message
    assert mine.rig.shown == []
    with pytest.raises(StoreError) as error:
        mine.capture(0, keep_raw=False)
    assert "keep_raw" not in str(error.value)

    disk(NEED.total)
    with caplog.at_level(logging.INFO, logger="rfpipe"):
        mine.capture(0)
    assert len(mine.rig.shown) == 4 + RAYS
    assert f"level 0: takes up to {NEED.total / 1e6:.3g} MB" in caplog.text

    disk(0)  # nothing to capture, nothing to refuse
    mine.capture(0)


def test_only_what_is_missing_counts(tmp_path: Path, disk: Disk) -> None:
    mine = acquisition(tmp_path)

    def stops(key: tuple[int, ...], frame: Any) -> Any:
        if key == (0, 7):
            raise KeyboardInterrupt
        return frame

    mine.rig = FaultyRig(matrix_rig(noise=CAMERA), stops)
    with pytest.raises(KeyboardInterrupt):
        mine.capture(0, batch_patterns=1)
    mine.rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    rest = DiskNeed.of(CAMERA, SHAPE, 1, RAYS - 7, RAYS)
    disk(rest.total - 1)
    with pytest.raises(StoreError, match="isn't begun"):
        mine.capture(0)
    disk(rest.total)
    mine.capture(0)
    assert mine.rig.shown == [(0, index) for index in range(7, RAYS)]

    # captured anew, its merged images are written over
    mine.merge(0)
    mine.rig = OperatorRig(matrix_rig()._operator, SHAPE, SHAPE, CAMERA, seed=9)
    present = bytes_on_disk(tmp_path / "L00/merge.zarr")
    disk(NEED.total - present - 1)
    with pytest.raises(StoreError, match="are there already"):
        mine.capture(0)
    disk(NEED.total - present)
    mine.capture(0)


def test_a_run_that_may_not_fit_is_warned_of_before_level_0(
    tmp_path: Path, disk: Disk, caplog: pytest.LogCaptureFixture
) -> None:
    mine = acquisition(tmp_path)
    disk(NEED.total)
    with caplog.at_level(logging.INFO, logger="rfpipe"):
        mine.capture(0, expected_patterns=10 * RAYS)
    assert f"all levels: about {10 * RAYS} patterns take up to" in caplog.text
    assert "The run will stop before the level that doesn't fit" in caplog.text


@pytest.mark.parametrize(
    ("name", "shape", "patterns"),
    [
        ("symmetric", (310, 350), 1085),
        ("dual", (310, 350), 7382),
        ("brute_force", (310, 350), 108_500),
        ("dual", (8, 8), 64),
    ],
)
def test_expected_patterns_are_those_of_the_thesis(
    name: str, shape: tuple[int, ...], patterns: int
) -> None:
    method, rays = get_method(name), RayDomain(shape)
    assert method.expected_patterns(rays, rays, options_of(method)) == patterns
