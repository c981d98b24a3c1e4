"""A collection: one scene that fails stops no other, and a new run does only what is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tests.workflow.harness import Workflow

ROWS = """name,kind,surfaces,file,negative,shape,channels,capture.floodlit_frames
first,plane,texture,,,6 x 8,1,
second,matrix,,bad.npy,{negative},6 x 8,1,
third,wedge,texture white,,,6 x 8,1,5
"""


def test_a_scene_that_fails_stops_no_other_and_what_is_done_stays(tmp_path: Path) -> None:
    workflow = Workflow(
        tmp_path,
        {"collection": "scenes.csv", "scenes": {}, "methods": {"hadamard": {}}},
    )
    matrix = np.eye(48)
    matrix[0, 1] = -1
    np.save(tmp_path / "bad.npy", matrix)
    (tmp_path / "scenes.csv").write_text(ROWS.format(negative="refuse"))
    said = workflow.run("--keep-going", succeeds=False)
    assert "results/catalogue/index.html: 1 failed, 2 done" in said
    page = workflow.path("catalogue/index.html").read_text()
    assert "light transport is finite and not negative" in page  # why it failed
    assert workflow.path("report/view/third_hadamard.html").exists()
    assert not workflow.path("report/index.html").exists()
    before = workflow.contents("first/hadamard")

    (tmp_path / "scenes.csv").write_text(ROWS.format(negative="zero"))
    said = workflow.run("--keep-going")
    assert "results/catalogue/index.html: 3 done" in said
    jobs = [line.split() for line in said.splitlines() if line.startswith(("acquire_", "total "))]
    assert jobs == [["acquire_simulated", "1"], ["total", "4"]]
    assert workflow.contents("first/hadamard") == before
    assert len(list(workflow.path("references").glob("black_*.zarr"))) == 1
