"""Runs that are stopped in the middle of a stage, and the runs that continue them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from tests.workflow.harness import (
    LONG,
    Workflow,
    freeze_writer,
    journal,
    kill_group,
)

BRUTE = "long/brute_force"


def test_a_killed_capture_continues_at_its_pattern(tmp_path: Path, undisturbed: Workflow) -> None:
    workflow = Workflow(tmp_path)
    store = workflow.path(f"{BRUTE}/L00/capture.zarr")
    process = workflow.start(LONG)
    freeze_writer(store, 12)
    kill_group(process, signal.SIGKILL)
    process.communicate()
    before = journal(store)
    assert 12 <= len(before) < 40
    assert not workflow.path(f"{BRUTE}/L00/capture.json").exists()

    workflow.unlock()
    output = workflow.run(LONG)

    assert f"{len(before)} of 40 patterns are captured; going on at pattern {len(before)}" in output
    assert f"level 0: {40 - len(before)} patterns in" in output
    assert journal(store)[: len(before)] == before
    assert workflow.contents(BRUTE) == undisturbed.contents(BRUTE)


@pytest.mark.slow
def test_an_orphaned_capture_excludes_a_second_writer(
    tmp_path: Path, undisturbed: Workflow
) -> None:
    workflow = Workflow(tmp_path)
    store = workflow.path(f"{BRUTE}/L00/capture.zarr")
    process = workflow.start(LONG)
    orphan = freeze_writer(store, 12)
    try:
        assert "locked" in workflow.run(LONG, succeeds=False)  # a second run in the same folder
        os.kill(process.pid, signal.SIGKILL)
        workflow.run("--unlock")
        output = workflow.run(LONG, succeeds=False)
        assert f"process {orphan} is writing this store" in output
        assert len(journal(store)) < 40
    finally:
        os.kill(orphan, signal.SIGKILL)
    workflow.run(LONG)
    assert workflow.contents(BRUTE) == undisturbed.contents(BRUTE)
    process.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_capture_closes_its_store_and_continues(
    tmp_path: Path, undisturbed: Workflow, number: signal.Signals
) -> None:
    workflow = Workflow(tmp_path)
    store = workflow.path(f"{BRUTE}/L00/capture.zarr")
    process = workflow.start(LONG)
    writer = freeze_writer(store, 12)
    kill_group(process, number)
    os.kill(writer, signal.SIGCONT)
    output = workflow.end(process, succeeds=False)
    assert "stopped; finished work is kept" in output
    captured = len(journal(store))
    assert 12 <= captured < 40
    assert not store.with_name(".capture.zarr.lock").exists()

    output = workflow.run(LONG)  # without locks to remove
    assert f"{captured} of 40 patterns are captured" in output
    assert workflow.contents(BRUTE) == undisturbed.contents(BRUTE)
