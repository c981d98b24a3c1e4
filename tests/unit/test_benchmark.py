"""The open benchmark: its cases, its table with one row per acquisition, and its page."""

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
    SMALL_SIDES,
    TARGETS,
    TOLERANCES,
    Case,
    appending,
    cases_of,
    is_needless,
    method_of,
    newest,
)
from benchmarks.methods.measure import measure
from benchmarks.methods.page import forecasts, regrets, small_scenes, write_page
from benchmarks.methods.scenes import KINDS

from rfpipe.errors import InputError

SCENES = ["wedge_iv", "tilted_wedge"]  # a tuning scene and a test scene
SMALL = ["--scenes", *SCENES, "--side", "8", "--seeds", "1", "--settings", "1", "--lights", "full"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a small benchmark: all methods on two matt scenes of 8 x 8 rays."""
    folder = tmp_path_factory.mktemp("docs") / "benchmark"
    benchmark.main([*SMALL, "--folder", str(folder)])
    return folder


@pytest.mark.slow
def test_the_benchmark_covers_all_methods_scenes_lights_and_seeds():
    cases = list(cases_of(list(KINDS)))
    for method in map(method_of, NAMES):
        cases_of_method = [case for case in cases if case.method == method.name]
        compared = {"target_error": TARGETS, "tolerance": TOLERANCES, None: [0]}
        settings = len(compared.get(method.trades, method.trials))
        assert len(cases_of_method) == len(KINDS) * len(CAMERAS) * len(SEEDS) * settings
        assert {case.option for case in cases_of_method} == {method.trades or ""}
    assert len({case.key for case in cases}) == len(cases)
    assert cases[0].method == "auto"


@pytest.mark.slow
def test_the_table_has_one_row_per_acquisition(run):
    table = newest(run / "acquisitions.csv")
    assert list(table.columns) == list(COLUMNS)
    assert set(zip(table["scene"], table["method"], strict=True)) == {
        (scene, method) for scene in SCENES for method in NAMES
    }
    done = table[table["status"] == "done"].set_index(["scene", "method"])
    for scene in SCENES:
        brute = done.loc[scene, "brute_force"]
        assert brute["patterns"] == 64
        seconds = sum(CAMERAS["full"].exposures)
        assert brute["exposure_s"] == pytest.approx(brute["pictures"] * seconds, rel=1e-4)
        all_on = round(brute["light_s"] / seconds - 64 * (1 / 64))
        assert brute["light_s"] == pytest.approx((all_on + 1) * seconds, rel=1e-4)
        assert 4 <= all_on <= 64  # as many references as needed
        assert 2 <= brute["pictures"] - 64 - all_on <= 8
        assert 0 < brute["error_mean"] < 0.01
        assert brute["error_mean"] <= brute["error_worst"]
        kinds = [brute[f"error_{kind}"] for kind in ("shapes", "bars", "spots")]
        assert brute["error_mean"] == pytest.approx(sum(kinds) / 3, rel=1e-4)
        assert brute["error_mean"] < brute["indirect_mean"]
        assert 0 < brute["photo_mean"] < 0.03
        assert math.isnan(brute["estimated_error"])
        assert done.loc[(scene, "near_far"), "estimated_error"] > 0
    assert set(table["held_out_scene"][table["scene"] == "tilted_wedge"]) == {True}


@pytest.mark.slow
def test_existing_acquisitions_are_not_repeated(run, monkeypatch):
    before = (run / "acquisitions.csv").read_bytes()
    monkeypatch.setattr(benchmark, "measure", lambda *_: pytest.fail("it was run again"))
    benchmark.main([*SMALL, "--folder", str(run)])
    assert (run / "acquisitions.csv").read_bytes() == before
    with (run / "acquisitions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len({row["key"] for row in rows}) == len(rows) == 2 * len(NAMES)


@pytest.mark.slow
def test_the_page_states_which_acquisitions_were_run(run):
    page = run.with_suffix(".md").read_text()
    planned = len(SCENES) * len(NAMES)
    assert f"Of the {planned} planned ones, 0 weren't needed" in page
    of_scene = [line for line in page.splitlines() if line.startswith("| tilted_wedge* | ")]
    assert "64" in of_scene[-1]
    assert len(of_scene) == 3  # regrets and the lowest number of patterns
    assert "| `auto` | full | test | 1 |" in page
    for name in ("errors.png", "estimates.png"):
        assert f"]({run.name}/{name})" in page
        assert (run / name).stat().st_size > 10_000
    assert len(page.split()) < 1500
    benchmark.main([*SMALL, "--seeds", "0", "1", "--table-only", "--folder", str(run)])
    page = run.with_suffix(".md").read_text()
    assert f"{planned} weren't run" in page


def test_a_page_without_full_light_leaves_its_sections_out(tmp_path):
    rows = [
        acquisition("auto", 0.02, 30, 0.018, light="sixteenth", status="done", code="",
                    estimated_error=0.016),
        acquisition("dual", 0.01, 60, 0.02, light="sixteenth", status="done", code=""),
        acquisition("dual", 0.01, 60, 0.02, status="failed", why="no disk"),
    ]  # fmt: skip
    for row in rows:
        row |= {"scene": "wedge_iv", "held_out_scene": False, "held_out_seed": False}
        row |= {
            "date": "2026-01-01",
            "machine": "a machine",
            "key": f"{row['light']} {row['method']}",
        }
        del row["section"]
    folder = tmp_path / "benchmark"
    table = folder / "acquisitions.csv"
    with appending(table) as append:
        for row in rows:
            append(row)
    write_page(folder, table, [])
    page = folder.with_suffix(".md").read_text()
    assert "| `auto` | sixteenth | tuning | 1 |" in page
    assert (folder / "estimates.png").stat().st_size > 10_000
    assert "errors.png" not in page
    assert "Pictures for an error" not in page
    assert not (folder / "errors.png").exists()


def test_a_table_of_other_columns_is_refused(tmp_path):
    (tmp_path / "acquisitions.csv").write_text("method,error\n")
    with pytest.raises(InputError, match="expected the columns key, scene"):
        benchmark.main([*SMALL, "--folder", str(tmp_path)])


@pytest.mark.slow
def test_refused_and_failed_acquisitions_have_rows_with_their_reasons(monkeypatch, tmp_path):
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


def acquisition(method, value, patterns, error, indirect=math.nan, **values):
    option = method_of(method).trades or ""
    return dict.fromkeys(COLUMNS, math.nan) | {
        "scene": "room", "side": "48", "channels": 1, "samples": 16, "light": "full", "seed": 1,
        "section": "tuning", "method": method, "option": option, "value": value,
        "patterns": patterns, "pictures": patterns + 10, "projector_rays": 2304,
        "error_mean": error, "indirect_mean": indirect, **values,
    }  # fmt: skip


def test_regret_is_against_the_best_setting_in_hindsight():
    rows = [
        acquisition("auto", 0.02, 40, 0.015, 0.10),
        acquisition("auto", 0.01, 80, 0.0121, 0.03),
        acquisition("auto", 0.005, 100, 0.004, 0.01),
        acquisition("symmetric", 0.01, 50, 0.0201, 0.09),
        acquisition("dual", 0.01, 60, 0.02, 0.2),
        acquisition("symmetric", 0.006, 160, 0.008, 0.03, pictures=240),  # counts as 170
        acquisition("auto", 0.02, 40, 0.015, seed=2),  # no other method was run
    ]
    regret = regrets(pd.DataFrame(rows)).set_index(["seed", "target"])
    assert list(regret.loc[1, "error"]) == pytest.approx([50 / 70, 90 / 170, 110 / 2314])
    assert list(regret.loc[1, "error_by"]) == ["dual", "symmetric", ""]
    assert list(regret.loc[1, "missed"]) == [False, True, False]
    assert list(regret.loc[1, "indirect"]) == pytest.approx([50 / 60, 90 / 170, 110 / 2314])
    assert math.isnan(regret.loc[(2, 0.02), "error"])


def test_forecasts_are_compared_with_what_acquisitions_took():
    rows = [
        acquisition("auto", 0.01, 30, 0.01),
        acquisition("auto", 0.01, 99, 0.01, section="test"),
        acquisition("auto", 0.02, 40, 0.01, section="test"),
        acquisition("dual", 0.01, 500, 0.01),
    ]
    table = forecasts(pd.DataFrame(rows)).splitlines()
    ratios = "100% | 0.91, 0.91, 0.91 | 100% | 0.93, 0.93, 0.93"
    assert table[2] == f"| full | tuning | 1 | 100% | {ratios} |"
    assert table[3].startswith("| full | test | 2 | 0% | 0% | 2.")


def test_small_scenes_compare_estimates_with_the_truth():
    rows = [
        acquisition("auto", 0.02, 20, 0.02, estimated_error=0.01, side="16x18"),
        acquisition("auto", 0.01, 20, 0.02, estimated_error=0.04, side="16x18", seed=0),
        acquisition("auto", 0.01, 20, 0.01, estimated_error=0.03, side="40x45", section="test"),
        acquisition("auto", 0.01, 20, 0.01, estimated_error=0.03, side="40x45", light="sixteenth"),
        acquisition("dual", 0.01, 20, 0.01, estimated_error=0.03, side="8"),
    ]
    table = small_scenes(pd.DataFrame(rows)).splitlines()
    assert [cell.strip() for cell in table[0].split("|")[1:-1]] == ["scene", "16x18", "40x45"]
    assert table[2].endswith("| 1.00 | 3.00 |")
    assert table[3] == "| **mean, tuning** | 1.00, 69%; 50% of 2 met |  |"
    assert table[4] == "| **mean, test** |  | 3.00, 0%; 100% of 1 met |"
    assert small_scenes(pd.DataFrame(rows[-1:])) == ""


def test_small_scenes_are_run_by_auto_in_full_light_unless_sides_are_named():
    def of(*arguments):
        return benchmark.asked_cases(benchmark.parsed(["--scenes", "wedge_iv", *arguments]))

    small = [case for case in of() if case.side in SMALL_SIDES]
    assert {case.method for case in small} == {"auto"}
    assert {case.light for case in small} == {"full"}
    assert {case.side for case in of()} == {"48", *SMALL_SIDES}
    assert {case.side for case in of("--side", "8", "16x18")} == {"8", "16x18"}


def test_a_tolerance_is_needless_once_a_coarser_one_has_reached_all():
    tighter = Case("room", "48", 1, 16, "full", 1, "dual", "tolerance", 1e-3)
    auto = acquisition("auto", 0.005, 80, 0.004, 0.02)
    for patterns, error, indirect, needless in (
        (200, 0.005, 0.02, True),
        (200, 0.005, math.nan, True),  # displaced rig
        (200, 0.005, 0.03, False),
        (200, 0.006, 0.02, False),
        (2304, 0.006, 0.03, True),
    ):
        coarser = acquisition("dual", 1e-2, patterns, error, indirect)
        assert is_needless(tighter, [auto, coarser]) is needless
    assert not is_needless(tighter, [auto, acquisition("dual", 1e-4, 200, 0.001, 0.01)])
