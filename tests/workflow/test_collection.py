"""A collection: one scene that fails stops no other, and a new run does only what is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rfpipe.stages.acquisitions import acquire_all, mark_outdated, outdated
from tests.workflow.harness import Workflow
from tests.workflow.stagewise import contents

from rfpipe.config import load_config
from rfpipe.costs import machine_memory_mb
from rfpipe.report.catalogue.items import item_of
from rfpipe.stages.jobs.workers import Resources

ROWS = """\
name,kind,surfaces,file,negative,shape,channels,capture.floodlit_frames,camera.bits,settings.seed
first,plane,texture,,,6 x 8,1,,,
second,matrix,,bad.npy,{negative},6 x 8,1,,,
third,wedge,texture white,,,6 x 8,1,5,10,3
"""


def test_a_scene_that_fails_stops_no_other_and_what_is_done_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert f'"mem_mb", {machine_memory_mb()})' in said  # that jobs side by side keep within
    jobs = [line.split() for line in said.splitlines() if line.startswith(("acquire_", "total "))]
    assert jobs == [["acquire_simulated", "1"], ["total", "4"]]
    assert workflow.contents("first/hadamard") == before
    assert len(list(workflow.path("references").glob("black_*.zarr"))) == 2  # two cameras

    monkeypatch.chdir(tmp_path)  # as Snakemake
    found = acquire_all(load_config(workflow.config), tmp_path / "elsewhere", Resources())
    assert [one.error for one in found] == [None] * 3
    for scene in ("first", "second", "third"):
        expected = workflow.contents(f"{scene}/hadamard")
        left = contents(tmp_path / "elsewhere" / scene / "hadamard")
        left = {name: left[name] for name in left if not name.endswith((".log", ".tsv", ".asked"))}
        assert left == {name: expected[name] for name in left}
        assert "transport.json" in left


def test_what_was_acquired_by_no_job_is_acquired_again_when_its_row_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workflow = Workflow(
        tmp_path, {"collection": "scenes.csv", "scenes": {}, "methods": {"hadamard": {}}}
    )
    rows = "name,kind,surfaces,shape,channels\na,plane,{},4 x 4,1\nb,plane,white,4 x 4,1\n"
    (tmp_path / "scenes.csv").write_text(rows.format("white"))
    monkeypatch.chdir(tmp_path)  # as Snakemake
    settings = load_config(workflow.config)
    acquire_all(settings, workflow.path(""), Resources())
    assert outdated(settings, workflow.path("")) == []
    items = [item_of(workflow.path(f"{name}/hadamard")) for name in "ab"]
    took = [item.seconds for item in items]
    assert all(seconds and seconds > 0 for seconds in took)
    acquire_all(settings, workflow.path(""), Resources())  # nothing to do: these were their seconds
    assert [item_of(workflow.path(f"{name}/hadamard")).seconds for name in "ab"] == took

    (tmp_path / "scenes.csv").write_text(rows.format("texture"))
    settings = load_config(workflow.config)
    assert outdated(settings, workflow.path("")) == [("a", "hadamard")]
    manifest = workflow.path("a/hadamard/transport.json")
    on_a_rig = settings.capture.model_copy(update={"rig": "remote"})
    captured = settings.model_copy(update={"capture": on_a_rig})
    mark_outdated(captured, workflow.path(""))  # what a rig captured is no job's to ask for again
    assert manifest.stat().st_mtime > 0
    said = workflow.run()
    jobs = [line.split() for line in said.splitlines() if line.startswith(("acquire_", "total "))]
    assert jobs == [["acquire_simulated", "1"], ["total", "6"]]
    assert outdated(settings, workflow.path("")) == []
    item = item_of(workflow.path("a/hadamard"))
    assert item.error is not None
    assert item.error < 0.05
    said = workflow.run()
    assert "Nothing to be done" in said
