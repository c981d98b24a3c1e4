"""Runs that begin with the transport of an earlier run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.workflow.harness import Workflow

from rfpipe import open_transport
from rfpipe.store import read_manifest
from rfpipe.store.arrays import open_arrays
from rfpipe.transport import save_transport

TARGET = "results/wedge/auto/transport.json"
SCENE = {"kind": "wedge", "surfaces": ["texture", "white"], "shape": [16, 18], "channels": 1}


def workflow_of(folder: Path, prior: Path | None, jobs: str = "acquisition") -> Workflow:
    workflow = Workflow(folder)
    workflow.configure(
        scenes={"wedge": SCENE},
        methods={"auto": {"prior": None if prior is None else str(prior)}},
        capture={"all_off_brackets": None, "all_on_brackets": None},
        resources={"jobs": jobs},
    )
    return workflow


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory, kernels: None) -> Path:
    """Transport of a run without a prior."""
    workflow = workflow_of(tmp_path_factory.mktemp("first"), None)
    workflow.run(TARGET)
    return workflow.path("wedge/auto/transport.zarr")


@pytest.mark.parametrize("jobs", ["acquisition", pytest.param("stage", marks=pytest.mark.slow)])
def test_an_unchanged_scene_takes_at_most_twelve_pictures(
    jobs: str, first: Path, tmp_path: Path
) -> None:
    prior = tmp_path / "prior.zarr"
    save_transport(open_transport(first), prior)
    workflow = workflow_of(tmp_path / "again", prior, jobs)
    workflow.run(TARGET)
    facts = read_manifest(workflow.folder / TARGET)
    before = read_manifest(first.with_suffix(".json"))
    assert sum(facts["pictures"].values()) <= 12 < sum(before["pictures"].values())
    assert facts["levels"][-1]["estimated_error"] <= 0.01
    assert facts["prior"] == {"path": str(prior), "digest": open_arrays(prior).digest}
    assert "Nothing to be done" in workflow.run(TARGET, "--dry-run")
    save_transport(open_transport(first), prior, "uint8")
    reasons = workflow.run(TARGET, "--dry-run").partition("Reasons:")[2]
    rule = "acquire" if jobs == "acquisition" else "schedule"
    assert re.search(rf"updated input files:\n *.*\b{rule}\b", reasons)


def test_a_missing_prior_ends_a_run_before_its_captures(tmp_path: Path) -> None:
    workflow = workflow_of(tmp_path, tmp_path / "missing.zarr")
    output = workflow.run(TARGET, succeeds=False)
    assert f"methods.auto.prior: there is no folder of a prior: '{tmp_path}/missing.zarr'" in output
    assert not workflow.path("wedge").exists()
