"""Error against patterns of all methods: the benchmark, its summary and its place in the report."""

import csv
import importlib.util
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.helpers import settings_of_a_plane

from rfpipe.report.inputs import BENCHMARKS, COLUMNS, Inputs
from rfpipe.report.speed_error import (
    against_symmetric,
    curves_figure,
    patterns_at_error,
    rivals_section,
    summary_lines,
)

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "bench_speed_error.py"


@pytest.fixture(scope="module")
def bench():
    name = "bench_speed_error"
    spec = importlib.util.spec_from_file_location(name, SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    yield module
    del sys.modules[name]


def run(method, setting, patterns, mean, worst, estimated=math.nan, **place):
    where = {"scene": "IV", "geometry": "wedge", "height": 64, "width": 64, "channels": 1,
             "noise": "default", "seed": 0, **place}  # fmt: skip
    found = (patterns, estimated, mean, worst, "spot", mean, worst, 1.0, 2.0)
    return dict(zip(COLUMNS, [method, *where.values(), setting, *found], strict=True))


TABLE = pd.DataFrame(
    [
        run("symmetric", 0.1, 10, 0.1, 0.2),
        run("symmetric", 0.01, 100, 0.01, 0.02),
        run("symmetric", 0.001, 1000, 0.001, 0.002),
        run("near_far", 0.05, 20, 0.01, 0.04, estimated=0.012),
        run("near_far", 0.01, 40, 0.0001, 0.002, estimated=0.001),
        run("near_far", 0.01, 40, 0.01, 0.02, estimated=0.01, scene="corner"),
        run("hadamard", 0, 4096, 0.001, 0.002),
    ]
)


def inputs_with(table):
    empty = pd.DataFrame()
    run, studies = settings_of_a_plane(), {"speed_error": table}
    return Inputs(run, [], {}, empty, empty, empty, studies, Path(), (Path(), Path()))


def test_patterns_are_interpolated_between_logarithms():
    patterns, errors = [1000, 10, 100], [0.001, 0.1, 0.01]
    assert patterns_at_error(patterns, errors, 0.01) == pytest.approx(100)
    assert patterns_at_error(patterns, errors, 10**-2.5) == pytest.approx(10**2.5)
    assert patterns_at_error(patterns, errors, 0.5) == pytest.approx(10)  # no run is coarser
    assert patterns_at_error(patterns, errors, 0.0005) == math.inf


def test_runs_that_take_more_patterns_for_more_error_do_not_count():
    patterns, errors = [10, 50, 100, 100], [0.1, 0.3, 0.01, 0.02]
    assert patterns_at_error(patterns, errors, 10**-1.5) == pytest.approx(10**1.5)
    assert patterns_at_error([7], [0.1], 0.1) == pytest.approx(7)


def test_near_far_runs_stand_beside_symmetric_ones_of_their_own_scene():
    beside = against_symmetric(TABLE)
    assert list(beside["scene"]) == ["IV", "IV", "corner"]
    first, second, elsewhere = beside.to_dict("records")
    assert first["symmetric_for_mean"] == pytest.approx(100)
    assert first["times_fewer_for_mean"] == pytest.approx(5)
    assert first["symmetric_for_worst"] == pytest.approx(50)
    assert first["times_fewer_for_worst"] == pytest.approx(2.5)
    assert first["estimate_ratio"] == pytest.approx(1.2)
    assert second["symmetric_for_mean"] == math.inf
    assert second["times_fewer_for_worst"] == pytest.approx(25)
    assert math.isnan(elsewhere["symmetric_for_mean"])


def test_the_summary_counts_good_estimates_and_ratios():
    lines = summary_lines(against_symmetric(TABLE))
    assert "67% of 3 runs" in lines[0]
    assert "least 5.0" in lines[1]
    assert "not reached by it in 1" in lines[1]
    assert "least 2.5, median 13.7, of 2 runs" in lines[2]
    assert summary_lines(against_symmetric(TABLE[:3])) == ["no run of near_far to compare"]


def test_each_scene_has_a_panel_and_seeds_are_averaged():
    other = run("symmetric", 0.1, 10, 0.4, 0.8, seed=1)
    figure = curves_figure(pd.concat([TABLE, pd.DataFrame([other])]))
    assert [axis.get_title() for axis in figure.axes] == ["IV", "corner"]
    lines = {line.get_label(): line.get_xydata() for line in figure.axes[0].lines}
    np.testing.assert_allclose(
        lines["Symmetric photography"], [[10, 20], [100, 1], [1000, 0.1]]
    )  # fmt: skip
    assert {"Near/far acquisition", "Hadamard multiplexing"} <= set(lines)
    assert figure.axes[0].get_xscale() == figure.axes[0].get_yscale() == "log"


def test_the_report_has_a_section_of_it_only_where_it_was_measured():
    section = rivals_section(inputs_with(TABLE))
    names = [block.name for block in section.blocks]
    assert len(names) == 3
    assert "Near/far against symmetric photography" in names
    assert "67% of 3 runs" in " ".join(section.text)
    beside = section.blocks[1].table
    assert [row[0] for row in beside.rows] == ["IV", "IV", "corner"]
    assert all(len(row) == len(beside.columns) for row in beside.rows)
    plain = rivals_section(inputs_with(TABLE[:3]))
    assert [block.name for block in plain.blocks][1:] == ["Runs"]
    assert rivals_section(replace(inputs_with(TABLE), benchmarks={})) is None
    assert BENCHMARKS["speed_error"] <= set(COLUMNS)


def test_the_benchmark_goes_on_where_it_was_and_keeps_its_rows(bench, tmp_path):
    path = tmp_path / "speed_error.csv"
    asked = ["--sizes", "8", "6x9", "--scenes", "IV", "--methods", "symmetric", "brute_force",
             "--settings", "0.1", "0.01", "--append", str(path)]  # fmt: skip
    bench.main(asked)
    table = pd.read_csv(path)
    assert tuple(table.columns) == COLUMNS
    assert list(table["method"]) == 2 * ["symmetric", "symmetric", "brute_force"]
    assert list(table["width"]) == [8, 8, 8, 9, 9, 9]
    assert list(table["patterns"][table["method"] == "brute_force"]) == [64, 54]
    assert (table["error_mean"] <= table["error_worst"]).all()
    assert table["estimated_error"].isna().all()

    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-2]))  # stopped before the last two
    bench.main(asked)
    again = path.read_text().splitlines(keepends=True)
    assert again[:-2] == lines[:-2]
    timed = COLUMNS.index("processing_seconds")
    rows, before = (list(csv.reader(part[-2:])) for part in (again, lines))
    assert [row[:timed] for row in rows] == [row[:timed] for row in before]


def test_the_benchmark_refuses_a_table_of_other_columns(bench, tmp_path):
    path = tmp_path / "speed_error.csv"
    path.write_text("method,patterns\nsymmetric,7\n")
    with pytest.raises(SystemExit, match="other columns"):
        bench.main(["--append", str(path)])


def test_the_benchmark_says_which_sizes_it_skips(bench, tmp_path, caplog, monkeypatch):
    def refuse(*_arguments, **_settings):
        raise bench.RfpipeError("too large for it")

    monkeypatch.setattr(bench.rfpipe, "acquire", refuse)
    path = tmp_path / "speed_error.csv"
    case = bench.Case("symmetric", "IV", "wedge", 8, 8, 1, "default", 0, 0.1)
    bench.measure_all([case], path)
    assert "skipped: symmetric on IV, 8 x 8, default, seed 0, tolerance 0.1: too large" in (
        caplog.text
    )
    assert path.read_text().splitlines() == [",".join(COLUMNS)]
