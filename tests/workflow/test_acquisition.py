"""A job of all stages: the same files as stage by stage, no work repeated, kills at any time."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from multiprocessing.queues import SimpleQueue
from pathlib import Path

import numpy as np
import pytest
from tests.workflow.stagewise import (
    CAMERA,
    SHAPE,
    StagewiseAcquisition,
    acquire,
    matrix_rig,
    stored,
)

from rfpipe.errors import LockedError
from rfpipe.provenance import generator
from rfpipe.stages.plan import Plan
from rfpipe.store import StoreLock

# Processes that have loaded all modules, but have run nothing yet.
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    [
        "tests.workflow.stagewise",
        "rfpipe.methods.symmetric.method",
        "numba",
        "rustworkx",
        "tqdm",
        "zarr",
    ]
)
FILE_OPERATIONS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir"}


def rig() -> object:
    return matrix_rig(noise=CAMERA)


@pytest.mark.parametrize("method", ["symmetric", "dual", "near_far"])
def test_a_job_of_all_stages_writes_the_files_of_single_stages(tmp_path: Path, method: str) -> None:
    acquire(tmp_path / "job", rig(), method)
    one_by_one = StagewiseAcquisition(tmp_path / "stages", rig())
    one_by_one.plan = Plan.of(method, method, (SHAPE, SHAPE, 1))
    one_by_one.acquire_levels()
    one_by_one.assemble()
    assert stored(tmp_path / "job") == stored(tmp_path / "stages")


def test_a_second_run_repeats_no_work(tmp_path: Path) -> None:
    folder = acquire(tmp_path, rig())
    before = stored(tmp_path)
    stores = [path for path in tmp_path.glob("L*/*") if path.is_dir()]
    times = [*tmp_path.glob("L*/*.json"), *tmp_path.glob("L*/*.tsv")]
    assert len(times) == 2 * (5 * 4 + 1)  # the last schedule has no patterns
    written = {path: path.stat().st_mtime_ns for path in [*stores, *times]}
    acquire(tmp_path, rig())
    assert stored(tmp_path) == before
    assert {path: path.stat().st_mtime_ns for path in written} == written
    for stage in ("normalize", "refine"):
        folder.manifest(2, stage).unlink()
        folder.store(2, stage).rename(tmp_path / stage)
    acquire(tmp_path, rig())
    arrays = stored(tmp_path)
    assert {name: arrays[name] for name in before} == before


def test_a_second_process_is_refused_for_one_acquisition(tmp_path: Path) -> None:
    with (
        StoreLock(tmp_path / "mine"),
        pytest.raises(LockedError, match=r"is writing this store .*mine"),
    ):
        acquire(tmp_path / "mine", rig())
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize("kills", [5, pytest.param(15, marks=pytest.mark.slow)])
def test_an_acquisition_killed_at_any_time_ends_with_the_same_bytes(
    tmp_path: Path, kills: int
) -> None:
    operations = _acquire_in_process(tmp_path / "whole", None)
    expected = stored(tmp_path / "whole")
    killed: set[str] = set()
    for number, moment in enumerate(generator(8).uniform(0, 1, kills)):
        last = 1 + int((number + moment) / kills * operations)
        path = tmp_path / str(number)
        _acquire_in_process(path, last)
        killed.add(_stage_under_way(path))
        acquire(path, rig())
        assert stored(path) == expected, f"killed at operation {last} of {operations}"
    assert len(killed) >= 3, killed  # the moments are random, but spread over all stages


def _acquire_in_process(path: Path, last: int | None) -> int:
    """Acquire in a process that is killed at a file operation; return their number if it isn't.

    Operations on files of `path` are counted in place of seconds, since these vary with the load.
    """
    counts = FORKS.SimpleQueue()
    process = FORKS.Process(target=_acquire_until, args=(path, last, counts))
    process.start()
    process.join()
    assert process.exitcode == (0 if last is None else -signal.SIGKILL)
    return counts.get() if last is None else last


def _acquire_until(path: Path, last: int | None, counts: SimpleQueue[int]) -> None:
    count = 0

    def kill_at_last(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal count
        if event in FILE_OPERATIONS and str(arguments[0]).startswith(f"{path}/"):
            count += 1
            if count == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(kill_at_last)
    acquire(path, rig())
    counts.put(count)


def _stage_under_way(path: Path) -> str:
    """Return the stage whose store was created last."""
    stores = [*path.glob("L*/*.zarr")]
    newest = np.argmax([store.stat().st_mtime_ns for store in stores]) if stores else 0
    return stores[newest].stem if stores else ""
