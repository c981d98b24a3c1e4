"""The command ``rfpipe run``: failing scenes, killed runs and repeated captures."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.workflow.harness import ROOT, Workflow, freeze_writer, journal, kill_group
from tests.workflow.test_reruns import jobs

SHAPE = {"shape": [6, 8], "channels": 1}
WALL = {"kind": "wedge", "surfaces": ["texture", "white"], **SHAPE}
CAPTURE = {"all_off_brackets": 2, "all_on_brackets": 4, "batch_patterns": 1}

pytestmark = pytest.mark.slow


def start(workflow: Workflow, *arguments: str) -> subprocess.Popen[str]:
    """Start ``rfpipe run`` as the leader of a new process group."""
    options = ("--directory", str(workflow.folder), "--configfile", str(workflow.config))
    return subprocess.Popen(
        [sys.executable, "-m", "rfpipe.cli", "run", *options, "--cores", "2", *arguments],
        cwd=workflow.folder.parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)])},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def run(workflow: Workflow, *arguments: str, status: int = 0) -> str:
    process = start(workflow, *arguments)
    output, _ = process.communicate(timeout=600)
    assert process.returncode == status, output
    return output


def settings(tmp_path: Path, **sections: Any) -> Workflow:
    return Workflow(tmp_path / "run", {"methods": {"dual": {}}, "capture": CAPTURE, **sections})


def test_the_last_line_names_failed_scenes_and_the_report_has_all_others(
    tmp_path: Path,
) -> None:
    matrix = np.eye(48)
    matrix[0, 1] = -1
    scenes = {"wall": WALL, "broken": {"kind": "matrix", "file": "bad.npy", **SHAPE}}
    workflow = settings(tmp_path, scenes=scenes)
    np.save(workflow.folder / "bad.npy", matrix)
    output = run(workflow, "--keep-going", status=1)
    log = workflow.path("broken/dual/L00/capture.log")
    assert log.exists()
    last = output.splitlines()[-1]
    assert last == f"rfpipe: failed: broken by dual, level 0, capture ({log})"
    page = workflow.path("report/index.html").read_text(encoding="utf-8")
    assert "Without acquisitions in which a stage failed: broken by dual" in page
    numbers = workflow.path("report/tables/errors.csv").read_text()
    assert "wall,dual" in numbers
    assert "broken" not in numbers
    matrix[0, 1] = 0
    np.save(workflow.folder / "bad.npy", matrix)
    output = run(workflow)
    assert "broken,dual" in workflow.path("report/tables/errors.csv").read_text()
    assert output.splitlines()[-1].startswith("report: ")
    assert {"capture_simulated", "report"} <= set(jobs(output))


@pytest.mark.parametrize("kind", ["stage", "acquisition"])
def test_repeating_a_level_captures_only_this_level(tmp_path: Path, kind: str) -> None:
    workflow = settings(tmp_path, scenes={"wall": WALL}, resources={"jobs": kind})
    run(workflow)
    before = workflow.contents("wall/dual")
    times = {path: path.stat().st_mtime_ns for path in workflow.path("").rglob("journal.jsonl")}
    output = run(workflow, "--retake", "wall/dual/1")
    assert "L01: its pictures are captured again; the previous ones stay" in output
    after = workflow.contents("wall/dual")
    aside = {name for name in after if "capture.before_1.zarr" in name}
    assert {name: after[name] for name in after if name not in aside} == before
    rewritten = [
        path
        for path, time in times.items()
        if path.parent.name == "capture.zarr" and path.stat().st_mtime_ns != time
    ]
    assert [path.parents[1].name for path in rewritten] == ["L01"]
    if kind == "stage":
        ran = jobs(output)
        assert ran["capture_simulated"] == 1
        assert ran["report"] == 1
    assert "Nothing to be done" in run(workflow)


def test_a_run_continues_after_kill_9(tmp_path: Path) -> None:
    workflow = settings(tmp_path, scenes={"wall": WALL}, methods={"brute_force": {}})
    store = workflow.path("wall/brute_force/L00/capture.zarr")
    target = "results/wall/brute_force/transport.json"
    process = start(workflow, target)
    freeze_writer(store, 8)
    output = run(workflow, target, status=1)
    assert re.search(r"process \d+ is running the workflow in this folder", output)
    assert "--unlock" not in output
    kill_group(process, signal.SIGKILL)
    process.communicate()
    captured = len(journal(store))
    output = run(workflow, target)
    assert "continuing the last run in this folder, which was killed" in output
    assert f"going on at pattern {captured}" in output


def test_the_last_line_names_missed_targets(tmp_path: Path) -> None:
    methods = {"near_far": {"target_error": 0.002, "patterns": 24}}
    workflow = settings(tmp_path, scenes={"wall": WALL}, methods=methods)
    last = run(workflow).splitlines()[-1]
    assert re.match(
        r"rfpipe: missed the target error: wall by near_far, estimated error .* %, target 0.2 % "
        r"\(the largest number of patterns is reached\)", last
    )  # fmt: skip
    acquired = json.loads(workflow.path("wall/near_far/transport.json").read_text())
    assert acquired["patterns"] == 24
