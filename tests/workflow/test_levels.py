"""An acquisition in one job: the stages' own bytes, and nothing done twice."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from tests.workflow.harness import TINY, Workflow
from tests.workflow.stagewise import CAMERA, CODE, SHAPE, Acquisition, contents, matrix_rig

from rfpipe.errors import LockedError
from rfpipe.stages import capture, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.store import StoreLock

STAGES = ("schedule", "merge", "normalize", "refine", "assemble")


def acquire(
    path: Path, method: str = "symmetric", until: levels.Until | None = None
) -> AcquisitionFolder:
    """Do what the workflow's job does."""
    folder = AcquisitionFolder(path, believing=True)
    levels.run(
        Plan(method, method, SHAPE, SHAPE, 1),
        folder,
        "matrix",
        partial(capture.run, matrix_rig(noise=CAMERA)),
        code=dict.fromkeys([*STAGES, "symmetry"], CODE),
        capture_options={"references": (2, 2)},
        merge_options={"saturation_fraction": 0.98, "mask_defects": True},
        normalization="per_channel",
        number_format="float32",
        asymmetry=0.05,
        watch={"mode": "warn", "looks": 0},
        resources=Resources(),
        until=until,
    )
    return folder


def left(path: Path) -> dict[str, bytes]:
    """Bytes of manifests and stores."""
    files = contents(path)
    return {name: files[name] for name in files if not name.endswith((".log", ".tsv"))}


@pytest.mark.parametrize("method", ["symmetric", "dual", "near_far", "low_rank"])
def test_a_job_leaves_what_its_stages_leave_one_by_one(tmp_path: Path, method: str) -> None:
    acquire(tmp_path / "job", method)
    one_by_one = Acquisition(tmp_path / "stages", matrix_rig(noise=CAMERA))
    one_by_one.plan = Plan(method, method, SHAPE, SHAPE, 1)
    one_by_one.watching = levels.watching_of(one_by_one.plan, 0.05, mode="warn", looks=0)
    for level in range(one_by_one.plan.n_levels):
        one_by_one.level(level)
    one_by_one.assemble()
    assert left(tmp_path / "job") == left(tmp_path / "stages")


@pytest.mark.parametrize("method", ["symmetric", "near_far"])
def test_jobs_of_one_level_each_leave_what_one_job_leaves(tmp_path: Path, method: str) -> None:
    whole = acquire(tmp_path / "one", method)
    folder, level, asked = AcquisitionFolder(tmp_path / "each"), 0, []
    while level is not None:
        acquire(folder.path, method, levels.Until(level, "capture"))
        assert not folder.manifest(level, "merge").exists()
        acquire(folder.path, method, levels.Until(level))
        assert levels.level_before(folder, level) == (asked[-1] if asked else None)
        asked.append(level)
        level = levels.level_after(folder, level)
        if level is not None:
            assert not folder.manifest(level, "capture").exists()
    assert asked == [
        level
        for level in range(len(list(whole.path.glob("L*"))))
        if whole.read_manifest(level, "schedule")["patterns"]
    ]
    assert not (folder.path / "transport.json").exists()
    acquire(folder.path, method)
    assert left(folder.path) == left(whole.path)


def test_a_run_of_a_job_a_level(undisturbed: Workflow, tmp_path: Path) -> None:
    workflow = Workflow(tmp_path / "run")
    workflow.configure(resources={"jobs": "level"})
    said = workflow.run(TINY)
    assert said.count("(Rule: level)") == 4
    assert workflow.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
    assert "Nothing to be done" in workflow.run(TINY)


def test_a_job_that_runs_again_does_nothing_again(tmp_path: Path) -> None:
    folder = acquire(tmp_path)
    before = left(tmp_path)
    stores = [path for path in tmp_path.glob("L*/*") if path.is_dir()]
    times = [*tmp_path.glob("L*/*.json"), *tmp_path.glob("L*/*.tsv")]
    assert len(times) == 2 * 5 * 4
    written = {path: path.stat().st_mtime_ns for path in [*stores, *times]}
    folder.manifest(3, "refine").unlink()
    acquire(tmp_path)
    assert left(tmp_path) == before
    del written[folder.manifest(3, "refine")]
    assert {path: path.stat().st_mtime_ns for path in written} == written


def test_what_is_missing_is_made_from_what_is_there(tmp_path: Path) -> None:
    folder = acquire(tmp_path)
    before = left(tmp_path)
    for stage in ("normalize", "refine"):
        folder.manifest(2, stage).unlink()
        folder.store(2, stage).rename(tmp_path / stage)
    acquire(tmp_path)
    found = left(tmp_path)
    assert {name: found[name] for name in before} == before


def test_one_job_at_a_time_works_on_an_acquisition(tmp_path: Path) -> None:
    with StoreLock(tmp_path / "mine"), pytest.raises(LockedError, match="mine: process"):
        acquire(tmp_path / "mine")
    assert not (tmp_path / "mine").exists()
