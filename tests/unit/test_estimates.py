"""The errors that methods estimate of themselves: kept, logged, and shown beside the true ones."""

import logging
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rfpipe import OperatorRig, acquire, open_transport
from rfpipe.config import Config
from rfpipe.methods import get_method
from rfpipe.photometry import sensor_from_config
from rfpipe.report import build_report
from rfpipe.report.errors import compare, estimates_figure, estimates_section, histories
from rfpipe.report.inputs import Inputs, Run
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.stages import evaluate, relight
from rfpipe.stages.refine import log_estimate
from rfpipe.store import write_manifest
from rfpipe.transport import save_transport
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.base import HISTORY_COLUMNS, estimates

LOW_RANK = "benchmarks.rivals.low_rank:LowRank"
ROWS = [
    {"level": 0, "patterns": 1},
    {"level": 1, "patterns": 14, "estimated_error": 0.08},
    {"level": 2, "patterns": 5},
    {"level": 3, "patterns": 20, "estimated_error": 0.012},
    {"level": 4, "patterns": 0},
]
COUNTS = {"nodes": 1, "empty": 0, "rank1": 0, "scalar": 0, "subdivided": 0}
WEDGE = {"kind": "wedge", "surfaces": ["texture", "white"], "shape": [8, 10]}
CONFIG = Config.model_validate(
    {
        "scenes": {"corner": WEDGE, "other": WEDGE},
        "methods": {
            "near_far": {"target_error": 0.02},
            "low_rank": {"method": LOW_RANK, "target_error": 0.02},
            "symmetric": {},
        },
    }
)


def history(rows: list) -> pd.DataFrame:
    return DenseTransport((1, 1), (1, 1), 1, rows, {}).history


def test_history_adds_up_patterns_and_leaves_out_levels_without_an_estimate() -> None:
    table = history(ROWS)
    assert list(table.columns) == list(HISTORY_COLUMNS) == ["level", "patterns", "estimated_error"]
    assert table.to_numpy().tolist() == [[1, 15, 0.08], [3, 40, 0.012]]
    assert table.to_dict("records") == estimates(ROWS)


@pytest.mark.parametrize("rows", [[], ROWS[:1]])
def test_without_an_estimate_history_is_empty_with_the_same_columns(rows: list) -> None:
    assert len(history(rows)) == 0
    pd.testing.assert_series_equal(history(rows).dtypes, history(ROWS).dtypes)


def random_matrix(rays: int = 256) -> np.ndarray:
    factors = np.random.default_rng(0).random((60, rays))
    return factors.T @ factors / rays + np.eye(rays)


def test_an_acquisition_and_its_store_know_what_was_estimated(tmp_path, caplog) -> None:
    caplog.set_level(logging.INFO, "rfpipe")
    rig = OperatorRig(random_matrix(), (16, 16), (16, 16))
    result = acquire(rig, LOW_RANK, target_error=0.005)
    assert result.history["patterns"].tolist() == [17, 33, 65, 129, 257]
    assert result.history["patterns"].iloc[-1] == result.patterns
    errors = result.history["estimated_error"]
    assert (errors.iloc[:-1] > 0.005).all()
    assert errors.iloc[-1] < errors.iloc[0]
    save_transport(result.transport, tmp_path / "transport.zarr")
    stored = open_transport(tmp_path / "transport.zarr")
    pd.testing.assert_frame_equal(stored.history, result.history)
    told = [record.message for record in caplog.records if "estimated error" in record.message]
    assert len(told) == 5
    assert told[0] == (
        f"level 1: estimated error {100 * errors[0]:.2f} % after 17 patterns, 0.5 % asked for"
    )


def test_a_method_without_estimates_has_an_empty_history() -> None:
    result = acquire(OperatorRig(np.eye(4), (2, 2), (2, 2)), "symmetric", progress=False)
    assert list(result.history.columns) == list(HISTORY_COLUMNS)
    assert result.history.empty


def test_the_log_tells_of_a_levels_own_estimate_alone(caplog) -> None:
    caplog.set_level(logging.INFO, "rfpipe")
    for count in range(len(ROWS) + 1):
        log_estimate(ROWS[:count], get_method("near_far").Options(target_error=0.01))
    assert [record.message for record in caplog.records] == [
        "level 1: estimated error 8.00 % after 15 patterns, 1 % asked for",
        "level 3: estimated error 1.20 % after 40 patterns, 1 % asked for",
    ]


def run(scene: str, method: str, rows: list) -> Run:
    options = CONFIG.methods[method].options()
    facts = {
        "levels": [{**COUNTS, **row} for row in rows],
        "patterns": 40,
        "options": options,
    }
    return Run(scene, method, CONFIG.scenes[scene], facts, images=None)


def made_up(with_truth: bool = True) -> Inputs:
    none = [{"level": 0, "patterns": 40}]
    noise = [{"level": 0, "patterns": 1}, {"level": 1, "patterns": 39, "estimated_error": 0.0}]
    runs = [
        run("corner", "near_far", ROWS),
        run("corner", "symmetric", none),
        run("other", "low_rank", noise),
    ]
    names = ["scene", "method", "pattern", "rms_total"]
    errors = [
        ("corner", "near_far", "bar", 0.005),
        ("corner", "near_far", "spot", 0.015),
        ("corner", "near_far", "dark", math.nan),
        ("corner", "symmetric", "bar", 0.5),
        ("other", "low_rank", "bar", 0.004),
    ]
    table = pd.DataFrame(errors if with_truth else [], columns=names)
    empty = pd.DataFrame()
    return Inputs(CONFIG, runs, table, empty, empty, Path())


def test_the_section_shows_each_estimate_and_how_good_the_last_was() -> None:
    section = estimates_section(made_up())
    chart, compared, steps = section.blocks
    assert compared.rows == [
        ["corner", "Near/far acquisition", "40", "2.00", "1.20", "1.00", "1.20"],
        ["other", "Optical low rank", "40", "2.00", "0.00", "0.40", "0.00"],
    ]
    assert [row[2:] for row in steps.rows] == [
        ["1", "15", "8.00"], ["3", "40", "1.20"], ["1", "40", "0.00"],
    ]  # fmt: skip
    assert "Dashed" in chart.caption
    assert "0.02 of" in chart.caption


def test_without_truth_nothing_is_compared_and_no_line_is_drawn() -> None:
    section = estimates_section(made_up(with_truth=False))
    chart, compared, _ = section.blocks
    assert [row[-2:] for row in compared.rows] == 2 * [["\N{EN DASH}", "\N{EN DASH}"]]
    assert [row[-3] for row in compared.rows] == ["1.20", "0.00"]
    assert "not known" in compared.caption
    assert "Dashed" not in chart.caption
    assert not [
        line for axis in chart.figure.axes for line in axis.lines if line.get_linestyle() == "--"
    ]


def test_the_curve_is_drawn_in_per_cent_with_truth_dashed_and_target_dotted() -> None:
    inputs = made_up()
    figure = estimates_figure(inputs, histories(inputs.runs), compare(inputs), 0.02)
    corner, other = figure.axes
    assert [axis.get_title() for axis in figure.axes] == ["corner", "other"]
    estimated, true, target = corner.lines
    assert estimated.get_label() == "Near/far acquisition"
    np.testing.assert_allclose(estimated.get_xydata(), [[15, 8], [40, 1.2]])
    assert true.get_color() == estimated.get_color()
    assert [line.get_linestyle() for line in (estimated, true, target)] == ["-", "--", ":"]
    np.testing.assert_allclose(true.get_ydata(), 1)
    np.testing.assert_allclose(target.get_ydata(), 2)
    # no estimate above 0 to draw on a logarithmic axis
    assert not len(other.lines[0].get_xydata())


def test_there_is_no_section_where_nothing_was_estimated() -> None:
    inputs = made_up()
    inputs.runs[:] = [run("corner", "symmetric", [{"level": 0, "patterns": 40}])]
    assert estimates_section(inputs) is None
    inputs.runs.clear()
    assert estimates_section(inputs) is None


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("estimates") / "results"
    low_rank = {"low_rank": CONFIG.methods["low_rank"]}
    config = CONFIG.model_copy(
        update={"scenes": {"corner": CONFIG.scenes["corner"]}, "methods": low_rank}
    )
    acquired = folder / "corner" / "low_rank"
    rig = SimulatedRig(scene_from_config(config.scenes["corner"]), sensor_from_config(None), 1)
    result = acquire(rig, LOW_RANK, progress=False, target_error=0.02)
    digest = save_transport(result.transport, acquired / "transport.zarr")
    about = {"scene": "corner", "method": "low_rank", "options": {"target_error": 0.02}}
    write_manifest(
        acquired / "transport.json", {**about, "digest": digest, "patterns": result.patterns}
    )
    relight.run(acquired, config.scenes["corner"], "code")
    tables = [folder / "report" / "tables" / f"{name}.csv" for name in ("errors", "speed_error")]
    evaluate.run([acquired / "relight.json"], *tables, 2.0)
    build_report(config, folder, folder / "report" / "index.html", *tables)
    return folder, result


def test_a_report_has_the_estimates_and_draws_no_terms_of_an_image_as_leaves(results) -> None:
    folder, result = results
    steps = pd.read_csv(folder / "report" / "tables" / "estimate_history.csv")
    assert steps["patterns"].tolist() == result.history["patterns"].tolist()
    assert not (folder / "report" / "figures" / "fig_5_10.png").exists()
    levels = pd.read_csv(folder / "report" / "tables" / "levels.csv")
    assert levels["rank1"].max() > 1
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    assert "(c) Entries of T" in page
    assert "(d) Level of the leaf" not in page
