"""`rfpipe run calibrate` on the simulated bench: one job per step, and no repeated step."""

import re
from pathlib import Path

import pytest
import yaml
from tests.workflow.harness import Workflow

from rfpipe.calibration.steps import STEPS

pytestmark = pytest.mark.slow

RIG = {
    "rays": [8, 8],
    "projector": {"options": {"settle_seconds": 0.0}},
    "bench": {
        "scene": {"kind": "wedge", "surfaces": ["white", "white"], "shape": [8, 8],
                  "channels": 1},
        "display_shape": [64, 64],
        "camera_shape": [32, 32],
    },
    "calibrate": {"dark_frames": 2, "levels": 3, "codes": 9, "symmetry_patterns": 3},
    "calibration": "mine",
}  # fmt: skip


def test_calibrate_runs_each_step_once(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path / "run")
    (workflow.folder / "rig.yaml").write_text(yaml.safe_dump(RIG))
    workflow.configure(rig_file="rig.yaml")
    assert "calibration_step" not in workflow.run("--dry-run")
    workflow.run("calibrate")
    folder = workflow.folder / "mine"
    assert {path.stem for path in (folder / "steps").glob("*.json")} == set(STEPS)
    assert (folder / "calibration.json").is_file()
    assert (folder / "report.html").is_file()
    assert "Nothing to be done" in workflow.run("calibrate")
    changed = {**RIG, "calibrate": {**RIG["calibrate"], "symmetry_patterns": 4}}
    (workflow.folder / "rig.yaml").write_text(yaml.safe_dump(changed))
    output = workflow.run("calibrate", "--dry-run")
    # only the step of symmetry
    assert re.search(r"calibration_step\s+1\s", output)
