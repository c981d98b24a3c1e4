"""The open benchmark: every method on every scene, a row an acquisition, and the page of them."""

import csv
import math

import pandas as pd
import pytest
from benchmarks.methods import __main__ as benchmark
from benchmarks.methods.cases import (
    CAMERAS,
    COLUMNS,
    NAMES,
    SEEDS,
    Case,
    cases_of,
    method_of,
    newest,
)
from benchmarks.methods.measure import measure
from benchmarks.methods.page import failures, summary_of, tightest
from benchmarks.methods.scenes import KINDS

from rfpipe.errors import InputError

SCENES = ["wedge_iv", "tilted_wedge"]  # an open one and one held out
SMALL = ["--scenes", *SCENES, "--side", "8", "--seeds", "1", "--settings", "1", "--lights", "full"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A part of the benchmark: all methods on two matt scenes of 8 x 8."""
    folder = tmp_path_factory.mktemp("docs") / "benchmark"
    benchmark.main([*SMALL, "--folder", str(folder)])
    return folder


def test_it_covers_all_methods_scenes_lights_and_seeds():
    cases = list(cases_of(list(KINDS)))
    for method in map(method_of, NAMES):
        own = [case for case in cases if case.method == method.name]
        settings = len(method.trials) if method.trades else 1
        assert len(own) == len(KINDS) * len(CAMERAS) * len(SEEDS) * settings
        assert {case.option for case in own} == {method.trades or ""}
    assert len({case.key for case in cases}) == len(cases)
    coarsest = [next(c for c in cases if c.method == name).value for name in ("symmetric", "dual")]
    assert coarsest == [1e-2, 1e-2]


@pytest.mark.slow
def test_the_table_has_a_row_an_acquisition(run):
    table = newest(run / "acquisitions.csv")
    assert list(table.columns) == list(COLUMNS)
    assert set(zip(table["scene"], table["method"], strict=True)) == {
        (scene, method) for scene in SCENES for method in NAMES
    }
    done = table[table["status"] == "done"].set_index(["scene", "method"])
    for scene in SCENES:
        brute = done.loc[scene, "brute_force"]
        assert brute["patterns"] == 64
        assert brute["brackets"] == 64 + 8 + 64
        assert brute["exposure_s"] == pytest.approx(136 * sum(CAMERAS["full"].exposures), rel=1e-4)
        lit = (64 * (1 / 64) + 64) * sum(CAMERAS["full"].exposures)
        assert brute["light_s"] == pytest.approx(lit, rel=1e-4)
        assert 0 < brute["error_mean"] < 0.01
        assert brute["error_mean"] <= brute["error_worst"]
        assert brute["error_mean"] < brute["unlit_mean"]
        assert 0 < brute["photo_mean"] < 0.03
        assert math.isnan(brute["estimated_error"])
        assert done.loc[(scene, "near_far"), "estimated_error"] > 0
    assert set(table["held_out_scene"][table["scene"] == "tilted_wedge"]) == {True}
    assert set(summary_of(table)["section"]) == {"open", "held out"}


@pytest.mark.slow
def test_what_is_there_is_not_run_again(run, monkeypatch):
    before = (run / "acquisitions.csv").read_bytes()
    monkeypatch.setattr(benchmark, "measure", lambda *_: pytest.fail("it was run again"))
    benchmark.main([*SMALL, "--folder", str(run)])
    assert (run / "acquisitions.csv").read_bytes() == before
    with (run / "acquisitions.csv").open() as file:
        kept = list(csv.DictReader(file))
    assert len({row["key"] for row in kept}) == len(kept) == 2 * len(NAMES)


@pytest.mark.slow
def test_the_page_says_what_was_run_and_what_was_not(run):
    page = run.with_suffix(".md").read_text()
    asked = len(SCENES) * len(NAMES)
    assert f"Of the {asked} that the command asked for, 0 weren't run" in page
    row = next(line for line in page.splitlines() if line.startswith("| tilted_wedge* | "))
    assert "64" in row
    for name in ("errors.png", "estimates.png"):
        assert f"]({run.name}/{name})" in page
        assert (run / name).stat().st_size > 10_000
    assert len(page.split()) < 1500
    benchmark.main([*SMALL, "--seeds", "0", "1", "--table-only", "--folder", str(run)])
    page = run.with_suffix(".md").read_text()
    assert f"Of the {2 * asked} that the command asked for, {asked} weren't run" in page


def test_a_table_of_other_columns_is_refused(tmp_path):
    (tmp_path / "acquisitions.csv").write_text("method,error\n")
    with pytest.raises(InputError, match="expected the columns key, scene"):
        benchmark.main([*SMALL, "--folder", str(tmp_path)])


@pytest.mark.slow
def test_a_method_that_refuses_or_fails_is_a_row_that_says_so(monkeypatch, tmp_path):
    case = Case("wedge_iv", "96", 1, 16, "full", 1, "compressive", "patterns", 50)
    refused = measure(case, tmp_path)
    assert refused["status"] == "refused"
    assert "up to 4096 rays" in refused["why"]
    assert "error_mean" not in refused

    def broken(*_args, **_options):
        raise ZeroDivisionError("by the way")

    monkeypatch.setattr("rfpipe.acquire", broken)
    failed = measure(Case("wedge_iv", "8", 1, 16, "full", 1, "dual", "tolerance", 0.01), tmp_path)
    assert (failed["status"], failed["why"]) == ("failed", "ZeroDivisionError: by the way")


def acquisition(method, value, error, **others):
    option = method_of(method).trades or ""
    return dict.fromkeys(COLUMNS, math.nan) | {
        "scene": "room", "side": "48", "light": "full", "seed": 1, "method": method,
        "option": option, "value": value, "what": "physical", "held_out_scene": False,
        "held_out_seed": False,
        "status": "done", "why": "", "error_mean": error, "error_worst": error, "patterns": 10,
        **others,
    }  # fmt: skip


def test_failures_are_found_by_rule():
    table = pd.DataFrame(
        [
            acquisition("symmetric", 1e-2, 0.02),
            acquisition("symmetric", 3e-3, 0.01),
            acquisition("symmetric", 1e-3, 0.013),
            acquisition("near_far", 0.05, 0.04, estimated_error=0.1),
            acquisition("near_far", 0.01, 0.03, estimated_error=0.03),
            acquisition("compressive", 50, math.nan, status="refused", why="too many rays"),
        ]
    )
    summary = summary_of(table)
    assert sorted(failures(summary)) == [
        ("compressive", "refused"),
        ("near_far", "missed"),
        ("near_far", "off"),
        ("symmetric", "rises"),
    ]
    assert dict(tightest(summary)[["method", "value"]].to_numpy()) == {
        "symmetric": 1e-3,
        "near_far": 0.01,
    }


def test_seeds_are_averaged_and_held_out_ones_kept_apart():
    table = pd.DataFrame(
        [
            acquisition("dual", 1e-2, 0.02, seed=1, estimated_error=0.01),
            acquisition("dual", 1e-2, 0.04, seed=2, estimated_error=0.08),
            acquisition("dual", 1e-2, 0.5, seed=0, held_out_seed=True),
        ]
    )
    summary = summary_of(table).set_index("section")
    assert summary.loc["open", "error_mean"] == pytest.approx(0.03)
    assert summary.loc["open", "error_worst"] == pytest.approx(0.04)
    assert summary.loc["open", "ratio"] == pytest.approx(1)  # half and twice
    assert summary.loc["held out", "error_mean"] == pytest.approx(0.5)
    assert list(summary["runs"]) == [2, 1]
