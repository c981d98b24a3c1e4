"""rfpipe installed from its wheel, without the source repository."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rfpipe.store import read_manifest

PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")


@pytest.mark.slow
def test_an_installed_rfpipe_runs_its_workflow_anywhere(tmp_path: Path) -> None:
    site, clone = tmp_path / "site", Path(__file__).parents[2]
    wheel = ("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, clone)
    subprocess.run([*PIP, *wheel], check=True)
    (built,) = tmp_path.glob("*.whl")
    subprocess.run([*PIP, "install", "--no-deps", "--target", site, built], check=True)
    settings = "methods: {brute_force: {}}\nscenes: {tiny: {kind: plane, shape: [2, 3]}}\n"
    (tmp_path / "mine.yaml").write_text(settings + "report: {page: false}\n")
    command = [sys.executable, "-m", "rfpipe.cli", "run", "--configfile", "mine.yaml"]
    environment = {**os.environ, "PYTHONPATH": str(site)}
    subprocess.run(command, cwd=tmp_path, env=environment, check=True)
    assert (tmp_path / "results/tiny/brute_force/transport.zarr").is_dir()
    options = read_manifest(tmp_path / "results/run.json")["options"]
    assert "site/rfpipe/_workflow/Snakefile" in options  # relative, so that the run can be copied
