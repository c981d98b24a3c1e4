"""The errors that methods estimate of themselves: kept, logged, and shown beside the true ones."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.reports import acquired, tables_of

from rfpipe import OperatorRig, acquire, open_transport
from rfpipe.config import Config
from rfpipe.report import build_report
from rfpipe.report.errors import estimates_section
from rfpipe.report.inputs import Inputs, Run
from rfpipe.transport import save_transport
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.base import HISTORY_COLUMNS, estimates

LOW_RANK = "benchmarks.rivals.low_rank:LowRank"
ROWS = [
    {"level": 0, "patterns": 1},
    {"level": 1, "patterns": 14, "estimated_error": 0.08},
    {"level": 2, "patterns": 5},
    {"level": 3, "patterns": 20, "estimated_error": 0.012, "estimated_indirect": 0.07},
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
    errors = ["estimated_error", "estimated_indirect"]
    assert list(table.columns) == list(HISTORY_COLUMNS) == ["level", "patterns", *errors]
    np.testing.assert_array_equal(table.to_numpy(), [[1, 15, 0.08, np.nan], [3, 40, 0.012, 0.07]])
    pd.testing.assert_frame_equal(pd.DataFrame(estimates(ROWS)), table)


@pytest.mark.parametrize("rows", [[], ROWS[:1]])
def test_without_an_estimate_history_is_empty_with_the_same_columns(rows: list) -> None:
    assert len(history(rows)) == 0
    pd.testing.assert_series_equal(history(rows).dtypes, history(ROWS).dtypes)


def test_an_acquisition_and_its_store_know_what_was_estimated(tmp_path) -> None:
    factors = np.random.default_rng(0).random((60, 256))
    rig = OperatorRig(factors.T @ factors / 256 + np.eye(256), (16, 16), (16, 16))
    result = acquire(rig, LOW_RANK, target_error=0.005)
    assert result.history["patterns"].tolist() == [17, 33, 65, 129, 257]
    assert result.history["patterns"].iloc[-1] == result.patterns
    errors = result.history["estimated_error"]
    assert (errors.iloc[:-1] > 0.005).all()
    assert errors.iloc[-1] < errors.iloc[0]
    save_transport(result.transport, tmp_path / "transport.zarr")
    stored = open_transport(tmp_path / "transport.zarr")
    pd.testing.assert_frame_equal(stored.history, result.history)


def run(scene: str, method: str, rows: list, **found: float) -> Run:
    options = CONFIG.methods[method].options()
    facts = {
        "levels": [{**COUNTS, **row} for row in rows],
        "patterns": 40,
        "options": options,
        **found,
    }
    return Run(scene, method, CONFIG.scenes[scene], facts, images=None)


def made_up(with_truth: bool = True) -> Inputs:
    def known(**errors: float) -> dict:
        return errors if with_truth else {}

    none = [{"level": 0, "patterns": 40}]
    noise = [{"level": 0, "patterns": 1}, {"level": 1, "patterns": 39, "estimated_error": 0.0}]
    runs = [
        run("corner", "near_far", ROWS, **known(mean_error=0.01, mean_indirect=0.07)),
        run("corner", "symmetric", none, **known(mean_error=0.5)),
        run("other", "low_rank", noise, **known(mean_error=0.004)),
    ]
    empty = pd.DataFrame(columns=["scene", "method", "patterns", "error"])
    return Inputs(CONFIG, runs, empty, empty, Path())


def test_the_section_shows_each_estimate_and_how_good_the_last_was() -> None:
    section = estimates_section(made_up())
    (compared,) = section.blocks
    assert compared.rows == [
        ["corner", "Near/far acquisition", "40", "2.00", "1.20", "1.00", "7.00", "1.20"],
        ["other", "Optical low rank", "40", "2.00", "0.00", "0.40", "\N{EN DASH}", "0.00"],
    ]


def test_without_truth_nothing_is_compared_and_no_line_is_drawn() -> None:
    section = estimates_section(made_up(with_truth=False))
    (compared,) = section.blocks
    assert [row[-3:] for row in compared.rows] == 2 * [3 * ["\N{EN DASH}"]]
    assert [row[-4] for row in compared.rows] == ["1.20", "0.00"]


def test_there_is_no_section_where_nothing_was_estimated() -> None:
    inputs = made_up()
    inputs.runs[:] = [run("corner", "symmetric", [{"level": 0, "patterns": 40}])]
    assert estimates_section(inputs) is None
    inputs.runs.clear()
    assert estimates_section(inputs) is None


def test_the_reports_tables_hold_what_the_acquisition_found(tmp_path) -> None:
    config = CONFIG.model_copy(
        update={
            "scenes": {"corner": CONFIG.scenes["corner"]},
            "methods": {"low_rank": CONFIG.methods["low_rank"]},
        }
    )
    acquired(tmp_path, config)
    build_report(config, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))
    history = open_transport(tmp_path / "corner" / "low_rank" / "transport.zarr").history
    tables, figures = tmp_path / "report" / "tables", tmp_path / "report" / "figures"
    (compared,) = pd.read_csv(tables / "estimates.csv").to_dict("records")
    (row,) = pd.read_csv(tables / "results.csv").to_dict("records")
    assert compared["true_error"] == row["mean_error"] > 0
    assert compared["true_indirect"] == row["mean_indirect"] > 0
    assert compared["patterns"] == history["patterns"].iloc[-1]
    assert (figures / "speed_error.png").is_file()
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert 'id="estimates"' in page
    # terms of an image are not drawn as leaves of blocks
    assert not (figures / "fig_5_10.png").exists()
    assert pd.read_csv(tables / "levels.csv")["rank1"].max() > 1
