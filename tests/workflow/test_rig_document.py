"""The commands of docs/rig.md on the simulated bench, and the quality of their results."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rfpipe import open_transport
from rfpipe.config import load_rig_config
from rfpipe.scenes import relighting_patterns, scene_from_config
from rfpipe.stages.evaluate import relative_rms
from rfpipe.stages.relight import images_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NEEDED = (
    "Makefile", "README.md", "Snakefile", "config", "profiles", "pyproject.toml",
    "requirements.lock", "src", "workflow",
)  # fmt: skip


def commands() -> str:
    """Return the document's commands as one script that stops its servers at the end."""
    blocks = re.findall(r"^```sh\n(.*?)^```", (ROOT / "docs/rig.md").read_text(), re.M | re.S)
    assert len(blocks) == 6
    script = "\n".join(blocks)
    assert "make serve RIG=$RIG > server.log 2>&1 &" in script
    return f"set -euo pipefail\nset -m\ntrap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n{script}"


def test_the_commands_of_the_document_acquire_the_scene(tmp_path: Path) -> None:
    for name in NEEDED:
        source = ROOT / name
        copy = shutil.copytree if source.is_dir() else shutil.copy2
        copy(source, tmp_path / name)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run(
        ["bash", "-c", commands()],
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": str(tmp_path / "src")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )
    served = (tmp_path / "server.log").read_text() if (tmp_path / "server.log").exists() else ""
    assert done.returncode == 0, done.stdout + served
    config = load_rig_config(ROOT / "config/bench.yaml")
    scene = scene_from_config(config.bench.scene)
    transport = open_transport(tmp_path / "captured/results/bench/auto/transport.zarr")
    for name, pattern in relighting_patterns(scene.shape).items():
        truth = images_of(scene, pattern[None])[0]
        assert relative_rms(transport.relight(pattern), truth) < 0.02, name
    assert (tmp_path / "bar.png").stat().st_size > 0
    assert (tmp_path / "captured/results/report/index.html").exists()
    calibration = json.loads((tmp_path / "calibration/calibration.json").read_text())
    assert {step["standing"] for step in calibration["facts"].values()} == {"good"}
    true = config.sensor
    for name in ("read_noise_electrons", "full_well_electrons", "dark_current_electrons"):
        assert calibration["camera"][name] == pytest.approx(getattr(true, name), rel=0.1), name
    assert calibration["camera"]["black_level_counts"] == pytest.approx(
        true.black_level_counts, abs=0.1
    )
