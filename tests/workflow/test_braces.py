"""Folder names with braces, which Snakemake would read as wildcards."""

import re
import shutil
from pathlib import Path

import pytest
import yaml
from tests.rigs.known_matrix import run
from tests.workflow.harness import ROOT, Workflow
from tests.workflow.test_calibrate import RIG

from rfpipe.errors import InputError

pytestmark = pytest.mark.slow

TINY = "results/tiny/brute_force/transport.json"
SETTINGS = {"scenes": {"tiny": {"kind": "plane", "shape": [2, 3]}}, "methods": {"brute_force": {}}}


@pytest.mark.parametrize("name", ["a{b}", "results{1}", "{n}", "open{", "a{b}/c"])
def test_a_run_in_a_folder_with_braces_is_refused(tmp_path: Path, name: str) -> None:
    workflow = Workflow(tmp_path / name, SETTINGS)
    output = workflow.run(TINY, succeeds=False)
    assert f"the run's folder is {workflow.folder}; Snakemake reads braces" in output
    assert "Traceback" not in output
    with pytest.raises(InputError, match=re.escape(f"{workflow.folder}; Snakemake reads braces")):
        run("run", "--directory", workflow.folder, "--configfile", workflow.config)


def test_a_workflow_in_a_folder_with_braces_is_refused(tmp_path: Path) -> None:
    clone = tmp_path / "clone{1}"
    clone.mkdir()
    shutil.copy(ROOT / "Snakefile", clone)
    shutil.copytree(ROOT / "workflow", clone / "workflow")
    workflow = Workflow(tmp_path / "run", SETTINGS)
    output = workflow.run("--snakefile", str(clone / "Snakefile"), TINY, succeeds=False)
    assert f"the workflow's folder is {clone}/workflow/rules; Snakemake reads braces" in output
    assert "Traceback" not in output


def test_a_calibration_in_a_folder_with_braces_is_refused(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path, {**SETTINGS, "rig_file": "rig.yaml"})
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({**RIG, "calibration": "mine{1}"}))
    output = workflow.run("calibrate", succeeds=False)
    assert "rig.yaml: calibration is mine{1}; Snakemake reads braces" in output
    assert "Traceback" not in output
