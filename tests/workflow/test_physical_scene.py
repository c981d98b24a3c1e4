"""Physically based scenes in the workflow: a displaced rig, many cameras, two rigs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from benchmarks import large
from tests.workflow.harness import Workflow

from rfpipe import open_transport
from rfpipe.config import load_config
from rfpipe.scenes import scene_from_config

CASES = {
    "aside": {"scene": "two_blocks_aside", "shape": [6, 8], "projector_shape": [5, 7]},
    "arc": {"scene": "still_life_arc", "shape": [4, 4], "projector_shape": [6, 6]},
    "pairs": {"scene": "sweets", "shape": [4, 5]},
}


@pytest.mark.slow
@pytest.mark.needs("llvm")
def test_physical_scenes_run_in_the_workflow_up_to_the_report(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path)
    light = {"kind": "mitsuba", "samples": 64, "bounces": 3}
    workflow.configure(
        scenes={name: light | case for name, case in CASES.items()},
        methods={"brute_force": {}},
        camera=None,
    )
    workflow.run()
    for name, scene in load_config(workflow.config).scenes.items():
        relit = open_transport(workflow.path(f"{name}/brute_force/transport.zarr"))
        pattern = np.linspace(0, 1, int(np.prod(scene.ray_shape)), dtype=np.float32)
        cached = scene.model_copy(update={"cache": str(tmp_path / scene.cache)})
        truth = scene_from_config(cached).apply(pattern[None])[0]
        image = relit.relight(pattern.reshape(scene.ray_shape)).reshape(truth.shape)
        assert truth.max() > 0
        np.testing.assert_allclose(image, truth, atol=1e-5 * truth.max())
    assert len(list((tmp_path / "results" / "recorded").glob("*/matrix.json"))) == len(CASES)
    page = workflow.path("report/index.html").read_text(encoding="utf-8")
    assert "80\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}4" in page


@pytest.mark.slow
@pytest.mark.needs("llvm")
def test_large_scenes_run_at_low_resolution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = yaml.safe_load(large.SETTINGS.read_text())
    for scene in settings["scenes"].values():
        scene |= {"shape": [12, 17], "samples": 256}
    settings["capture"]["batch_patterns"] = 16
    workflow = Workflow(tmp_path)
    workflow.configure(**settings)
    workflow.run()
    for name, value in (
        ("SETTINGS", workflow.config), ("TABLES", tmp_path), ("PICTURE", tmp_path / "large.png")
    ):  # fmt: skip
        monkeypatch.setattr(large, name, value)
    monkeypatch.chdir(tmp_path)
    large.main(str(tmp_path))
    table = pd.read_csv(tmp_path / "large.csv")
    ends = table.groupby(["scene", "method"]).tail(1)
    assert len(ends) == 5
    assert (ends["mean_error"] < 0.1).all()
    assert (ends["verified"] < 0.1).all()
    auto_rows = table[(table["method"] == "auto") & (table["estimated_error"] > 0)]
    ratio = auto_rows["mean_error"] / auto_rows["estimated_error"]
    assert ratio.between(1 / 3, 3).all()
    costs = pd.read_csv(tmp_path / "large_stages.csv")
    assert set(costs["stage"]) >= {"schedule", "capture", "merge", "normalize", "refine"}
    assert (tmp_path / "large.png").stat().st_size > 10_000
