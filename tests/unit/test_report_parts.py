"""Parts of a report: styles, seeds, estimates, targets, levels, rigs, and files for papers."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.results.report_folders import WEDGE

from rfpipe import acquire
from rfpipe.calibration.steps import STEPS
from rfpipe.config import Config
from rfpipe.relighting import picture_errors, picture_squared_norms
from rfpipe.report import errors, glance, leaves, setup, text
from rfpipe.report import verification as verification_page
from rfpipe.report.inputs import RelitAcquisition, ReportInputs
from rfpipe.report.page import Illustration, Section, Table, latex_table, write_page
from rfpipe.report.targets import ending_of, missed_target_texts
from rfpipe.report.text import DASH
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import planes_scene
from rfpipe.stages import verification
from rfpipe.stages.evaluate import errors_by_level
from rfpipe.store import write_manifest

GREY = {**WEDGE, "channels": 1}
SEEDS = {f"corner_{seed}": {**GREY, "seed": seed} for seed in (1, 2, 3)}
CONFIG = Config.model_validate(
    {
        "scenes": {**SEEDS, "other": {**GREY, "bounces": 1}},
        "methods": {
            "near_far": {"target_error": 0.02},
            "near_far_fine": {"method": "near_far", "target_error": 0.005},
            "symmetric": {},
            "symmetric_fine": {"method": "symmetric", "tolerance": 1e-4},
            "dual": {},
        },
    }
)


def row(level: int, patterns: int, **more: Any) -> dict[str, Any]:
    counts = dict.fromkeys(("empty", "rank1", "scalar", "subdivided"), 0)
    return {"level": level, "patterns": patterns, "nodes": 0, **counts, **more}


def inputs_of(
    results: Path, config: Config = CONFIG, rows: list[dict[str, Any]] | None = None
) -> ReportInputs:
    """Return the inputs of a report whose runs all have the given levels."""
    level_rows = rows or [row(0, 1), row(1, 12, estimated_error=0.01)]
    patterns = sum(it["patterns"] for it in level_rows)
    bundle: Any = SimpleNamespace(names=["truth"])
    runs = [
        RelitAcquisition(scene, method, config.scenes[scene],
            {"levels": level_rows, "patterns": patterns, "options": {}, "bytes": 1000,
             "coaxial": True, "mean_error": 0.01, "level_errors": [0.01]}, bundle)
        for scene, method in config.acquisitions
    ]  # fmt: skip
    speed = pd.DataFrame(
        [
            {"scene": run.scene, "method": run.method, "level": level, "patterns": 10 * level + n,
             "pictures": 10 * level + n + 20, "error": 0.1 / (level + n)}
            for n, run in enumerate(runs)
            for level in ((1, 2, 3) if run.method.startswith("sym") else (1,))
        ]
    )  # fmt: skip
    return ReportInputs(config, runs, pd.DataFrame(), speed, results)


# ---- Speed against error


def test_settings_of_a_method_have_different_colours_and_markers(tmp_path: Path) -> None:
    inputs = inputs_of(tmp_path)
    styles = [inputs.style(method) for method in inputs.methods]
    assert len(styles) == 5
    for name in ("color", "marker", "label"):
        assert len({style[name] for style in styles}) == 5, name
    subject = CONFIG.methods["near_far"].plugin
    assert (styles[0]["color"], styles[0]["marker"]) == (subject.colour, subject.marker)


def test_estimates_are_drawn_at_their_levels_and_unlike_true_errors(tmp_path: Path) -> None:
    values = [None, 0.05, 0.05, 0.05, 0.02, 0.02, 0.03]
    rows = [
        row(level, 4, **({} if value is None else {"estimated_error": value}))
        for level, value in enumerate(values)
    ]
    assert [it["level"] for it in errors.made_estimates(rows)] == [1, 4, 6]
    assert errors.made_estimates(rows[:1]) == []
    inputs = inputs_of(tmp_path, rows=rows)
    for run, level in product(inputs.runs, range(len(rows))):
        folder = inputs.results / run.scene / run.method / f"L{level:02}"
        folder.mkdir(parents=True)
        references = {"reference_brackets": {"shape": [10, 2, 8]}} if level == 0 else {}
        write_manifest(folder / "capture.json", {"patterns": 4, "shape": [4, 2, 8], **references})
    steps = errors.histories(inputs)
    (other_group,) = (group for group in inputs.seed_groups if group.name == "other")
    figure = errors.speed_figure(inputs, [other_group], inputs.speed_error, steps)
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata())]
    crosses = [line for line in lines if line.get_marker() == "x"]
    truths = [line for line in lines if line.get_marker() not in ("x", "None", "", "|", "_")]
    assert {tuple(line.get_xdata()) for line in crosses} == {(18, 30, 38)}
    assert {line.get_linestyle() for line in crosses} == {":"}
    assert len(truths) == len(inputs.methods)
    single_marks = [line for line in truths if len(line.get_xdata()) == 1]
    assert len(single_marks) == 3
    assert all(line.get_markersize() > 6 for line in single_marks)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {*map(inputs.title, inputs.methods), "as the method estimated it"} < {*names}
    assert len(names) == len({*names})


def test_scenes_that_differ_only_in_seeds_are_one_panel_with_error_bars(
    tmp_path: Path,
) -> None:
    inputs = inputs_of(tmp_path)
    groups = {group.title: group.scenes for group in inputs.seed_groups}
    assert groups == {"corner, 3 seeds": tuple(SEEDS), "other": ("other",)}
    rows = pd.DataFrame({"scene": ["a", "a", "b", "b"], "pictures": [1, 5, 3, 7],
                         "error": [0.4, 0.1, 0.2, 0.3]})  # fmt: skip
    means = errors.over_seeds(rows, "error")
    np.testing.assert_allclose(means["pictures"], [2, 6])
    np.testing.assert_allclose(means["error"], [30, 20])
    np.testing.assert_allclose(means["error_sd"], [10 * np.sqrt(2)] * 2)
    table = glance.seeds_table(inputs, [glance.result_of(inputs, run) for run in inputs.runs])
    assert table is not None
    assert {cells[0] for cells in table.rows} == {"corner"}
    assert table.rows[0][table.columns.index("error, %")] == "1.00 ± 0.00"
    figure = errors.speed_figure(
        inputs, inputs.seed_groups, inputs.speed_error, errors.histories(inputs)
    )
    assert [axis.get_title() for axis in figure.axes[:2]] == ["corner, 3 seeds", "other"]
    bars, none = (len(axis.collections) for axis in figure.axes[:2])
    assert bars > none == 0


@pytest.mark.parametrize(
    ("change", "together"),
    [
        ({"seed": 7}, True),
        ({"about": {"number": 3}}, True),
        ({"settings": {"seed": 5}}, True),
        ({"bounces": 2}, False),
        ({"shape": [8, 12]}, False),
        ({"settings": {"camera": {"bits": 10}}}, False),
        ({"methods": {"dual": {}}}, False),
    ],
)
def test_scenes_are_grouped_if_only_their_seeds_differ(
    change: dict, together: bool, tmp_path: Path
) -> None:
    scenes = {"corner_1": GREY, "corner_2": {**GREY, **change}}
    config = Config.model_validate({"scenes": scenes, "methods": {"symmetric": {}, "dual": {}}})
    assert len(inputs_of(tmp_path, config).seed_groups) == (1 if together else 2)


def test_a_captured_scene_s_error_is_that_of_its_verification(tmp_path: Path) -> None:
    inputs = inputs_of(tmp_path)
    captured: Any = SimpleNamespace(names=[])
    runs = [replace(run, images=captured, verified={"mean_error": 0.03}) for run in inputs.runs]
    captured_inputs = replace(inputs, runs=runs, speed_error=inputs.speed_error[:0])
    shown = errors.known_errors(captured_inputs)
    assert shown["error"].tolist() == [0.03] * len(runs)
    assert errors.known_errors(inputs) is inputs.speed_error


# ---- Levels and errors


@pytest.mark.parametrize(
    ("rows", "level_errors", "expected"),
    [
        # fitted to all pictures together, followed by levels without patterns
        ([row(0, 1), row(1, 12), row(2, 0), row(3, 0)], [0.1], [(1, 13, 0.1)]),
        ([row(0, 1)], [0.5], [(0, 1, 0.5)]),
        ([row(0, 0)], [0.5], [(0, 0, 0.5)]),
        # level by level
        ([row(0, 1), row(1, 4), row(2, 0), row(3, 8)], [0.9, 0.5, 0.5, 0.1],
         [(0, 1, 0.9), (1, 5, 0.5), (3, 13, 0.1)]),
        ([row(0, 1), row(1, 4), row(2, 8)], [0.5, 0.1], [(1, 5, 0.5), (2, 13, 0.1)]),
    ],
)  # fmt: skip
def test_levels_have_one_numbering(rows: list, level_errors: list, expected: list) -> None:
    assert errors_by_level({"levels": rows, "level_errors": level_errors}) == expected


def test_errors_of_dark_pictures_are_also_relative_to_their_own_norm() -> None:
    floodlit = np.ones((4, 5, 1))
    patterns = np.ones((2, 4, 5))
    truth = np.stack([floodlit, 0.1 * floodlit])
    total, indirect = picture_squared_norms(truth + 0.01, truth, patterns, floodlit)
    assert indirect is None
    np.testing.assert_allclose(total.plain_errors, [0.01, 0.1])
    np.testing.assert_allclose(total.errors, [0.01, 0.02])
    np.testing.assert_allclose(
        picture_errors(truth + 0.01, truth, patterns, floodlit)[0], total.errors
    )
    black = picture_squared_norms(0 * truth, 0 * truth, patterns, floodlit)[0]
    np.testing.assert_array_equal(black.plain_errors, 0)


# ---- Targets


@pytest.mark.parametrize(
    ("facts", "reason", "expected"),
    [
        ({"mean_error": 0.03}, "all rounds are shown", ["3.00 %", "all rounds are shown"]),
        ({"mean_error": 0.03, "estimated_error": 0.009}, "", ["3.00 %", "estimated 0.90 %"]),
        ({"mean_error": None, "estimated_error": 0.02}, "", ["2.00 %", "estimated by the method"]),
        ({"mean_error": 0, "mean_indirect": 0.2, "target_indirect": 0.1}, "", ["indirect light"]),
        ({"mean_error": 0.01}, "", None),
        ({"mean_error": 0.010004}, "", None),  # shown alike
        ({"mean_error": 0.03, "target_error": None}, "", None),
        ({"mean_error": None}, "", None),
    ],
)  # fmt: skip
def test_a_missed_target_is_reported_with_the_reason(
    facts: dict, reason: str, expected: list[str] | None
) -> None:
    sentences = [
        *missed_target_texts({"target_error": 0.01, "verified": "exact truth", **facts}, reason)
    ]
    if expected is None:
        assert sentences == []
    else:
        (sentence,) = sentences
        assert all(part in sentence for part in ["TARGET MISSED", *expected])


@pytest.mark.parametrize(
    ("fraction", "expected"),
    [
        (1e-5, "0.001"), (-1.23e-4, "-0.012"), (1e-9, "1e-07"), (0, "0.00"), (0.00104, "0.10"),
        (0.0153, "1.53"), (None, DASH), (np.nan, DASH), (0.12, "12"),
    ],
)  # fmt: skip
def test_small_percentages_have_significant_digits(fraction: Any, expected: str) -> None:
    assert text.rounded_percent(fraction) == expected


def test_a_small_target_is_shown_in_reports_and_outcomes() -> None:
    row = {"target_error": 1e-5, "verified": "exact truth", "mean_error": 2.5e-5}
    (sentence,) = missed_target_texts(row, "")
    assert "0.0025 %" in sentence
    assert "0.001 %" in sentence
    pictures = pd.DataFrame({"error": [2.5e-5], "standard_error": [1e-6]})
    compared = SimpleNamespace(mean_error=2.5e-5, standard_error=1e-6, table=pictures)
    outcome = verification.Verification.against(compared, 1e-5)  # type: ignore[arg-type]
    assert "0.0025%" in outcome.reason
    assert "0.001%" in outcome.reason


def test_the_scatter_of_few_pictures_is_no_missed_target() -> None:
    row = {"target_error": 0.01, "verified": "9 pictures"}
    assert [*missed_target_texts({**row, "mean_error": 0.014}, "", by_few_pictures=True)] == []
    (sentence,) = missed_target_texts({**row, "mean_error": 0.016}, "", by_few_pictures=True)
    assert "1.60 %" in sentence
    (sentence,) = missed_target_texts({**row, "estimated_error": 0.014}, "", by_few_pictures=True)
    assert "estimated by the method" in sentence


def test_alarms_and_their_rows_are_red(tmp_path: Path) -> None:
    table = Table("Costs", "", ["scene", "error, %"], [["a", "1"], ["b", "2"]],
                  alarmed=frozenset([1]), is_folded=False)  # fmt: skip
    section = Section("glance", "At a glance", [table], alarms=["b: TARGET MISSED"])
    write_page(tmp_path / "index.html", "title", "lead", [section], {})
    page = (tmp_path / "index.html").read_text("utf-8")
    assert '<p class="alarm">b: TARGET MISSED</p>' in page
    assert page.count('<tr class="alarm">') == 1
    assert page.index('<tr class="alarm">') < page.index(">b</th>")
    assert page.index('class="alarm">b: TARGET') < page.index("<table>")


# ---- Rigs


RIG = {
    "kind": "devices",
    "sensor": {"kind": "resampled",
               "sensor": {"bits": 14, "exposures": [0.002, 0.5], "black_level": 71.5}},
    "calibration": {"dark": {"title": "dark", "standing": "good"}},
}  # fmt: skip


def test_a_captured_run_shows_its_rig_s_sensor_and_no_camera_of_a_simulation(
    tmp_path: Path,
) -> None:
    config = Config.model_validate(
        {
            "scenes": {"desk": {"kind": "captured", "shape": [8, 10]}},
            "methods": {"dual": {}},
            "capture": {"rig": "remote"},
        }
    )
    (tmp_path / "desk/dual/L00").mkdir(parents=True)
    write_manifest(tmp_path / "desk/dual/L00/capture.json", {"patterns": 1, "rig": RIG})
    settings, rig, _ = setup.setup_section(inputs_of(tmp_path, config)).blocks
    assert isinstance(settings, Table)
    assert isinstance(rig, Table)
    assert not any(name.startswith("camera.") for name, _ in settings.rows)
    shown = dict(rig.rows)
    assert rig.rows[0][0].startswith("sensor.")
    assert shown["sensor.bits"] == "14"
    assert shown["sensor.exposures"] == "[0.002, 0.5]"
    assert shown["sensor.black_level"] == "71.5"
    assert not any(name.startswith("calibration") for name in shown)
    simulated = setup.setup_section(inputs_of(tmp_path)).blocks
    assert [block.name for block in simulated if isinstance(block, Table)] == [
        "Settings", "Versions",
    ]  # fmt: skip
    assert any(name.startswith("camera.") for name, _ in simulated[0].rows)


def test_verdicts_are_listed_in_the_order_of_the_steps(tmp_path: Path) -> None:
    config = CONFIG.model_copy(update={"scenes": {"corner_1": CONFIG.scenes["corner_1"]}})
    verdicts = {
        step: {"title": step, "standing": "good", "verdict": "Good."} for step in sorted(STEPS)
    }
    for scene, method in config.acquisitions:
        (tmp_path / scene / method / "L00").mkdir(parents=True)
        facts = {"patterns": 1, "rig": {"kind": "devices", "calibration": verdicts}}
        write_manifest(tmp_path / scene / method / "L00/capture.json", facts)
    (table,) = verification_page.verdicts_section(inputs_of(tmp_path, config)).blocks
    assert isinstance(table, Table)
    assert [step for step, _ in table.rows] == [*STEPS]


# ---- Runs of some methods


def test_settings_are_those_of_the_methods_that_ran(tmp_path: Path) -> None:
    inputs = inputs_of(tmp_path)
    ran = [run for run in inputs.runs if run.method == "near_far"]
    settings = setup.setup_section(replace(inputs, runs=ran)).blocks[0]
    assert isinstance(settings, Table)
    methods = {name.split("methods.")[1].split(".")[0]
               for name, _ in settings.rows if "methods." in name}  # fmt: skip
    assert methods == {"near_far"}


@pytest.mark.parametrize(
    ("rows", "is_shown"),
    [
        ([row(0, 1), row(1, 12)], False),
        ([row(0, 1, nodes=4), row(1, 12, nodes=9)], False),
        ([row(0, 1, nodes=1, subdivided=1), row(1, 12, nodes=4, rank1=3, empty=1)], True),
        ([row(0, 1, nodes=1, scalar=1)], False),
    ],
)
def test_only_runs_with_leaves_have_a_section_of_leaves(
    rows: list[dict[str, Any]], is_shown: bool, tmp_path: Path
) -> None:
    section = leaves.leaves_section(inputs_of(tmp_path, rows=rows))
    assert (section is not None) == is_shown


# ---- Files for papers


def test_figures_are_also_vectors_of_the_same_bytes(tmp_path: Path) -> None:
    from rfpipe.report.drawing import new_figure

    for folder in ("one", "two"):
        figure, ((axis,),) = new_figure(1, 1, (2, 2))
        axis.plot([1, 2], [3, 4])
        shown = Illustration("Curve", "", "curve", figure)
        page = tmp_path / folder / "index.html"
        write_page(page, "title", "lead", [Section("curve", "Curve", [shown])], {})
        assert 'href="figures/curve.pdf"' in page.read_text("utf-8")
    first, second = (tmp_path / name / "figures/curve.pdf" for name in ("one", "two"))
    assert first.read_bytes().startswith(b"%PDF")
    assert b"/FontFile2" in first.read_bytes()  # an embedded TrueType font
    assert first.read_bytes() == second.read_bytes()


def test_special_characters_of_a_table_are_escaped_in_latex() -> None:
    table = Table("T", "", ["scene", "error, %"], [["planes_iv", "1 ± 2"], ["a&b#{}", DASH]])
    lines = latex_table(table).splitlines()
    assert lines[1] == r"\begin{tabular}{lr}"
    assert r"scene & error, \% \\" in lines
    assert r"planes\_iv & 1 $\pm$ 2 \\" in lines
    assert r"a\&b\#\{\} & -- \\" in lines
    assert lines[-1] == r"\end{tabular}"


def test_a_method_states_why_it_ended_above_its_target() -> None:
    rig = SimulatedRig(planes_scene("wedge", ("texture", "texture"), (8, 10), channels=1))
    stopped = acquire(rig, "near_far", progress=False, target_error=1e-4, patterns=13)
    assert "number of patterns" in ending_of(stopped.transport.level_rows)
    reached = acquire(rig, "near_far", progress=False, target_error=0.5)
    assert ending_of(reached.transport.level_rows) == ""
