"""A group of jobs that no node of the cluster could run ends the run before it is submitted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.workflow.harness import DUAL, LONG, Workflow


@pytest.mark.slow
def test_a_group_that_no_node_can_run_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sinfo = tmp_path / "bin" / "sinfo"
    sinfo.parent.mkdir()
    sinfo.write_text("#!/bin/sh\necho 1\n")
    sinfo.chmod(0o755)
    monkeypatch.setenv("PATH", f"{sinfo.parent}:{os.environ['PATH']}")
    workflow = Workflow(tmp_path / "run", {"resources": {"jobs": "acquisition"}})
    submitted = tmp_path / "submitted"
    said = workflow.run(
        DUAL, LONG, "--executor", "cluster-generic", "--jobs", "4",
        "--cluster-generic-submit-cmd", f"touch {submitted}; false; #",
        "--groups", "acquire=small", "--group-components", "small=2",
        succeeds=False,
    )  # fmt: skip
    assert "Add --cores 1: the jobs of a group then run one after the other" in said
    assert not submitted.exists()
