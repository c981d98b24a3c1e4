"""Small versions of the thesis' figures by their rules: all exist and have content."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml
from figures.index import THESIS

ROOT = Path(__file__).parents[2]
_LEAST_BYTES = 4_000  # least deviation of a picture that isn't blank


def _snakemake(folder: Path, *arguments: str) -> str:
    command = [
        str(Path(sys.executable).with_name("snakemake")), "--snakefile",
        str(ROOT / "figures/Snakefile"), "--directory", str(folder), "--cores", "2", *arguments,
    ]  # fmt: skip
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout + ended.stderr


def test_without_llvm_make_figures_names_the_package_to_install() -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "figures", "check"], capture_output=True, text=True, cwd=ROOT,
        env={**os.environ, "DRJIT_LIBLLVM_PATH": "none"}, check=False,
    )  # fmt: skip
    assert ended.returncode == 1
    assert "apt-get install libllvm19" in ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.needs("llvm")
def test_make_figures_writes_all_figures_and_none_is_blank(tmp_path: Path) -> None:
    settings = yaml.safe_load((ROOT / "figures/figures.yaml").read_text())
    settings["size"] = {"side": 12, "samples": 32, "positions": 3, "sides": [4, 8]}
    config = tmp_path / "tiny.yaml"
    config.write_text(yaml.safe_dump(settings))
    _snakemake(tmp_path, "--configfile", str(config))
    folder = tmp_path / "results" / "figures"
    page = (folder / "index.html").read_text()
    for number in ("2.2", "3.1", "3.2", "3.3", "3.4", "3.6", "3.7", "3.8", "3.9", "3.10",
                   "5.6", "5.7", "5.8", "5.11", "B.1"):  # fmt: skip
        assert f"<b>Fig. {number}" in page
    for picture in folder.glob("*.png"):
        assert picture.name in page
        assert picture.stat().st_size > _LEAST_BYTES, picture.name
    assert list(pd.read_csv(folder / "table_3_1.csv")["figure"]) == list(THESIS["3.1"])
    assert len(pd.read_csv(folder / "table_5_1.csv")) == 2
    assert "Nothing to be done" in _snakemake(tmp_path, "--configfile", str(config))
