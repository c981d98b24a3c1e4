"""Scripts that make the thesis' figures and tables."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import figures
import numpy as np
import pandas as pd
import pytest
import yaml
from figures.__main__ import SCRIPTS, main, run
from figures.common import Size
from figures.growth import line_fit
from figures.index import cost_table, write_index

ROW = {
    "table": "3.1", "figure": "Fig. 3.4, box", "scene": "two blocks", "camera_rays": 64,
    "rays": 25, "patterns": 20, "pictures": 30, "megabytes": 1.0, "processing_s": 6.0,
    "error": 0.1, "positions": 1,
}  # fmt: skip
LEVELS = np.arange(3, 8)


def fits(patterns: np.ndarray) -> pd.DataFrame:
    numbers = pd.DataFrame({"levels": LEVELS, "rays": 4**LEVELS, "patterns": patterns})
    return pd.DataFrame([line_fit(numbers)], index=["box"])


def test_lines_and_power_laws_are_fitted_to_patterns_by_resolution() -> None:
    line = fits(7 + 30 * LEVELS).loc["box"]
    assert line["slope"] == pytest.approx(30)
    assert line["explained"] == pytest.approx(1)
    assert fits(4**LEVELS).loc["box", "exponent"] == pytest.approx(1)


def test_costs_are_compared_with_brute_force_and_the_thesis() -> None:
    (costs,) = cost_table("3.1", [ROW], pd.DataFrame()).to_dict("records")
    assert "extrapolated_line" not in costs
    assert costs["brute_force_days"] == pytest.approx(1 / (60 * 24))
    assert costs["min"] == pytest.approx(30 / 25 + 0.1)
    assert costs["thesis_patterns"] == 352
    (fitted,) = cost_table("3.1", [ROW], fits(10 * LEVELS)).to_dict("records")
    assert fitted["extrapolated_line"] == pytest.approx(20 + 10 * np.log2(512 * 512 / 25) / 2)
    arc = {**ROW, "figure": "Fig. 3.9, 80 positions", "patterns": 100, "positions": 5}
    (field,) = cost_table("3.1", [arc], fits(10 * LEVELS)).to_dict("records")
    assert field["brute_force"] == 125
    assert field["extrapolated_line"] == pytest.approx(80 * (20 + 5 * np.log2(162_900 / 25)))


def test_the_page_shows_the_files_of_a_script(tmp_path: Path) -> None:
    folder = tmp_path / "results" / "figures"
    folder.mkdir(parents=True)
    tables = tmp_path / "results" / "report" / "tables"
    tables.mkdir(parents=True)
    acquired = {**ROW, "scene": "planes_ii", "method": "symmetric", "mean_error": 0.01}
    pd.DataFrame([acquired]).to_csv(tables / "results.csv", index=False)
    run("walk", folder, Size())
    assert "Here 13 patterns without conflicts and 21" in (folder / "walk.json").read_text()
    assert (folder / "fig_3_1.png").stat().st_size > 10_000
    (folder / "box.json").write_text(json.dumps({"shown": [], "costs": [ROW]}))
    write_index(folder)
    page = (folder / "index.html").read_text()
    assert (folder / "fig_3_1.pdf").read_bytes().startswith(b"%PDF")
    assert "href='fig_3_1.pdf'" in page
    for shown in ("fig_3_1.png", "Table 3.1", "Table 5.1", "takes 21 patterns", "table_5_1.csv"):
        assert shown in page
    assert pd.read_csv(folder / "table_5_1.csv")["thesis_patterns"].tolist() == [1085]


@pytest.mark.parametrize(
    ("script", "first", "is_meant"),
    [("plane", "planes", True), ("lightfield", "light_field", True), ("nope", "", False)],
)
def test_an_unknown_script_is_refused_with_the_known_names(
    script: str, first: str, is_meant: bool, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(sys, "argv", ["figures", script])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    message = capsys.readouterr().err
    assert f"there is no script '{script}'; " in message
    names = message.rpartition("There are ")[2].strip().split(", ")
    assert {*names} == {*SCRIPTS, "index", "check"}
    assert names[0] == (first or names[0])
    assert (f"did you mean {first}?" in message) == is_meant


def test_all_scripts_of_the_settings_are_known() -> None:
    folder = Path(figures.__file__).parent
    for settings in folder.glob("figures*.yaml"):
        assert {*yaml.safe_load(settings.read_text())["scripts"]} <= {*SCRIPTS}


WRONG = {
    "bench_symmetry": "nope",
    "bench_storage": "wide",
    "measure_places": "large",
    "bench_relight": "--ful=1",
    "viewer_speed": "nope.html",
}


@pytest.mark.slow
@pytest.mark.parametrize("script", WRONG)
def test_a_wrong_argument_of_a_benchmark_ends_it_with_a_message(script: str) -> None:
    command = [sys.executable, "-m", f"benchmarks.{script}", WRONG[script]]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "error: " in done.stderr
    assert "Traceback" not in done.stderr
