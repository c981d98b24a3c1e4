"""Collections: a failing scene stops no other, and a new run completes only missing scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.workflow.harness import Workflow
from tests.workflow.test_reruns import jobs

from rfpipe.jobs.workers import machine_memory_mb

ROWS = """\
name,kind,surfaces,file,shape,channels,capture.all_on_brackets,camera.bits,settings.seed
first,plane,{first},,6 x 8,1,,,
second,matrix,,bad.npy,6 x 8,1,,,
third,wedge,texture white,,6 x 8,1,5,10,3
"""


@pytest.mark.slow
def test_a_failing_scene_stops_no_other_and_finished_scenes_persist(
    tmp_path: Path,
) -> None:
    workflow = Workflow(
        tmp_path,
        {
            "collection": "scenes.csv",
            "scenes": {},
            "methods": {"hadamard": {}},
            "resources": {"jobs": None},
        },
    )
    matrix = np.eye(48)
    matrix[0, 1] = -1
    np.save(tmp_path / "bad.npy", matrix)
    rows = tmp_path / "scenes.csv"
    rows.write_text(ROWS.format(first="texture"))
    output = workflow.run("--keep-going", succeeds=False)
    assert "results/catalogue/index.html: 1 failed, 2 done" in output
    page = workflow.path("catalogue/index.html").read_text()
    assert "light transport is finite and not negative" in page  # the reason of the failure
    assert workflow.path("report/view/third_hadamard.html").exists()
    assert not workflow.path("report/index.html").exists()
    before = workflow.contents("first/hadamard")

    np.save(tmp_path / "bad.npy", np.maximum(matrix, 0))
    output = workflow.run("--keep-going")
    assert "results/catalogue/index.html: 3 done" in output
    assert f'"mem_mb", {machine_memory_mb()})' in output  # shared by parallel jobs
    assert jobs(output) == {"acquire": 1, "relight": 1, "view": 1, "all": 1}
    assert workflow.contents("first/hadamard") == before

    rows.write_text(ROWS.format(first="white"))  # another row
    output = workflow.run("--keep-going")
    assert jobs(output) == {"acquire": 1, "relight": 1, "view": 1, "all": 1}
    assert workflow.contents("first/hadamard") != before
