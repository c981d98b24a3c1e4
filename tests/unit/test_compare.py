"""Methods at equal error: curves through the levels and acquisitions of finished runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.rigs.known_matrix import run

from rfpipe.errors import InputError, StoreError
from rfpipe.report import catalogue
from rfpipe.report.compare import CostPoint, compare, frontier
from rfpipe.report.inputs import seconds_spent
from rfpipe.store import write_arrays, write_manifest

Levels = Sequence[tuple[int, float]]


def relit(
    results: Path, scene: str, method: str, levels: Levels, truth: float = 1.0, **options: Any
) -> None:
    """Write the manifests of an acquisition: patterns and error of each level."""
    folder = results / scene / method
    rows = [{"level": level, "patterns": count} for level, (count, _) in enumerate(levels)]
    known = [error for _, error in levels if error is not None]
    facts = {"scene": scene, "method": method, "options": options, "levels": rows,
             "patterns": sum(count for count, _ in levels)}  # fmt: skip
    if truth:
        facts["level_errors"] = known
        floodlit = np.full((4, 5, 1), truth, np.float32)
        write_arrays(folder / "relight.zarr", {"floodlit_truth": floodlit}, {})
    for level, (count, _) in enumerate(levels):
        at = folder / f"L{level:02}"
        at.mkdir(parents=True)
        reference = {} if level else {"reference_brackets": {"digest": "it", "shape": [10, 1]}}
        write_manifest(at / "capture.json", {"patterns": count, "shape": [count, 1], **reference})
        (at / "refine.benchmark.tsv").write_text("s\th:m:s\n5.0\t0:00:05\n")
        (at / "capture.benchmark.tsv").write_text("s\th:m:s\n99.0\t0:01:39\n")
    write_manifest(folder / "relight.json", facts)


MISSING = {
    "nothing": ((), "has no acquisition"),
    "begun": (("L00",), r"desk by dual: .*desk/dual/relight\.json is missing.*rfpipe run"),
    "no error": (("L00", "relight"), "but no known error"),
}


@pytest.mark.parametrize("inside", ["", "results"])
@pytest.mark.parametrize("case", MISSING)
def test_missing_parts_of_a_run_are_named(case: str, inside: str, tmp_path: Path) -> None:
    made, message = MISSING[case]
    results = tmp_path / "results"
    results.mkdir()
    if "relight" in made:
        relit(results, "desk", "dual", [(3, None)], truth=0)
        write_manifest(results / "desk/dual/verification.json", {})
    elif made:
        (results / "desk/dual/L00").mkdir(parents=True)
    with pytest.raises(StoreError, match=message):
        compare([tmp_path / inside])


def costs(table: pd.DataFrame, scene: str, method: str, error: float) -> Any:
    rows = table[
        (table["scene"] == scene) & (table["method"] == method) & (table["error"] == error)
    ]
    (row,) = rows.to_dict("records")
    return row


def test_costs_are_interpolated_between_levels(tmp_path: Path) -> None:
    relit(tmp_path, "room", "symmetric", [(1, 0.4), (19, 0.1), (80, 0.001)])
    table = compare([tmp_path], [0.1, 0.01, 0.0001], 2.0)
    at_level = costs(table, "room", "Symmetric photography", 0.1)
    assert at_level["patterns"] == pytest.approx(20)
    assert at_level["pictures"] == pytest.approx(30)
    assert at_level["seconds"] == pytest.approx(2 * 30 + 2 * 5)
    between = costs(table, "room", "Symmetric photography", 0.01)
    assert between["patterns"] == pytest.approx(np.sqrt(20 * 100))
    assert between["pictures"] == pytest.approx(np.sqrt(30 * 110))
    assert between["note"] == ""
    free = costs(compare([tmp_path], [0.1], 0.0), "room", "Symmetric photography", 0.1)
    assert free["seconds"] == pytest.approx(2 * 5)
    missed = costs(table, "room", "Symmetric photography", 0.0001)
    assert np.isnan(missed["patterns"])
    assert missed["note"] == "not reached: 0.10 % after 100 patterns"


def test_seconds_are_those_of_the_report_and_of_the_catalogue(tmp_path: Path) -> None:
    relit(tmp_path, "room", "symmetric", [(1, 0.4), (19, 0.1)])
    folder = tmp_path / "room" / "symmetric"
    (folder / "transport.benchmark.tsv").write_text("s\th:m:s\n3.0\t0:00:03\n")
    spent = seconds_spent(folder, 2.0)
    assert spent == (2 * 30, 2 * 5 + 3)  # all pictures, and all jobs except captures
    row = costs(compare([tmp_path], [0.1], 2.0), "room", "Symmetric photography", 0.1)
    assert row["seconds"] == pytest.approx(spent.total)
    assert catalogue._numbers(folder, 2.0)["seconds"] == pytest.approx(spent.total)


def test_acquisitions_of_several_runs_by_one_method_make_one_curve(tmp_path: Path) -> None:
    first, second = tmp_path / "one" / "results", tmp_path / "two" / "results"
    relit(first, "room", "near_far", [(1, None), (12, 0.04)], target_error=0.05)
    relit(second, "room", "near_far", [(1, None), (51, 0.01)], target_error=0.02)
    table = compare([tmp_path / "one", second], [0.04, 0.02, 0.005], 2.0)
    assert set(table["method"]) == {"Near/far acquisition"}
    first, between, beyond = table.to_dict("records")
    assert first["patterns"] == 13
    assert "at most" in first["note"]
    assert between["patterns"] == pytest.approx(26)
    assert "not reached: 1.00 % after 52" in beyond["note"]


def test_scenes_and_options_that_differ_have_separate_curves(tmp_path: Path) -> None:
    first, second = tmp_path / "one", tmp_path / "two"
    relit(first, "room", "near_far", [(13, 0.04)], target_error=0.05, noise_significance=3)
    relit(first, "room", "fine", [(52, 0.01)], target_error=0.02, noise_significance=1)
    relit(second, "room", "near_far", [(13, 0.03)], truth=2.0, target_error=0.05)
    (first / "report").mkdir()
    settings = {"methods": {"fine": {"method": "near_far"}}, "capture": {"seconds_per_pattern": 7}}
    report = {"provenance": {"configuration": settings}}
    (first / "report/results.json").write_text(json.dumps(report), "utf-8")
    table = compare([first, second], [0.04])
    assert {*table["scene"]} == {f"room ({first})", f"room ({second})"}
    rows = table[table["scene"] == f"room ({first})"]
    assert {*rows["method"]} == {"Near/far acquisition (1)", "Near/far acquisition (2)"}
    assert 7 * (13 + 10) + 5 in rows["seconds"].tolist()


def test_a_captured_scene_counts_by_its_verification(tmp_path: Path) -> None:
    relit(tmp_path, "desk", "dual", [(1, None), (20, None)], truth=0)
    with pytest.raises(StoreError, match="but no known error"):
        compare([tmp_path])
    write_manifest(tmp_path / "desk/dual/verification.json", {"mean_error": 0.03})
    (row,) = compare([tmp_path], [0.05]).to_dict("records")
    assert (row["patterns"], row["pictures"]) == (21, 31)


def test_a_curve_has_the_least_error_for_its_patterns() -> None:
    points = [CostPoint(error, count, count, count) for error, count in
              [(0.1, 20), (0.4, 1), (0.2, 30), (0.05, 40), (0.06, 40), (0.05, 50)]]  # fmt: skip
    assert [(it.patterns, it.error) for it in frontier(points)] == [(1, 0.4), (20, 0.1), (40, 0.05)]


def test_an_exact_method_is_the_end_of_a_curve(tmp_path: Path) -> None:
    relit(tmp_path, "room", "brute_force", [(1, 0.5), (99, 0.0)])
    (row,) = compare([tmp_path], [0.01]).to_dict("records")
    assert row["patterns"] == 100


@pytest.mark.parametrize("error", [0.0, -0.1, float("nan")])
def test_errors_must_be_positive(tmp_path: Path, error: float) -> None:
    with pytest.raises(InputError, match="above 0"):
        compare([tmp_path], [error])


def test_the_command_prints_and_writes_the_table(tmp_path: Path) -> None:
    relit(tmp_path, "room", "symmetric", [(1, 0.4), (19, 0.1), (80, 0.001)])
    relit(tmp_path, "room", "near_far", [(13, 0.02)])
    table = tmp_path / "compared.csv"
    shown = run("compare", tmp_path, "--output", table)
    assert [name in shown for name in ("Symmetric", "Near/far", "not reached")] == [True] * 3
    written = pd.read_csv(table)
    assert set(written["error"]) == {0.05, 0.02, 0.01, 0.005, 0.002, 0.001}
    run("compare", tmp_path, "-e", "0.01", "-o", tmp_path / "compared.tex")
    assert r"\begin{tabular}{lllrrrl}" in (tmp_path / "compared.tex").read_text("utf-8")
    with pytest.raises(InputError, match=r"expected \.csv .*\.tex"):
        run("compare", tmp_path, "-o", tmp_path / "compared.xlsx")


def test_errors_that_no_method_reaches_are_left_out_unless_named(tmp_path: Path) -> None:
    relit(tmp_path, "room", "near_far", [(13, 0.03)])
    shown = run("compare", tmp_path)
    assert " 5 " in shown
    assert "not reached" not in shown
    assert "not reached" in run("compare", tmp_path, "-e", "0.001")


@pytest.mark.parametrize(("error", "meant"), [("5", "0.05"), ("1", "0.01"), ("0", "fraction")])
def test_percent_are_refused_as_errors(tmp_path: Path, error: str, meant: str) -> None:
    with pytest.raises(InputError, match=f"--error {error}.*{meant}"):
        run("compare", tmp_path, "-e", error)
