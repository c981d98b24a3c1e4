"""Estimated errors in the table of levels, in stores and in reports."""

import numpy as np
import pandas as pd
import pytest
from tests.results.report_folders import acquired, tables_of

from rfpipe import OperatorRig, acquire, open_transport
from rfpipe.config import Config
from rfpipe.report import build_report
from rfpipe.transport import save_transport
from rfpipe.transport.base import HISTORY_COLUMNS, estimates
from rfpipe.transport.dense import DenseTransport

pytestmark = pytest.mark.usefixtures("quick_fonts")

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


def test_history_sums_patterns_and_omits_levels_without_an_estimate() -> None:
    table = history(ROWS)
    errors = ["estimated_error", "estimated_indirect"]
    assert list(table.columns) == list(HISTORY_COLUMNS) == ["level", "patterns", *errors]
    np.testing.assert_array_equal(table.to_numpy(), [[1, 15, 0.08, np.nan], [3, 40, 0.012, 0.07]])
    pd.testing.assert_frame_equal(pd.DataFrame(estimates(ROWS)), table)


@pytest.mark.parametrize("rows", [[], ROWS[:1]])
def test_history_without_estimates_is_empty_with_the_same_columns(rows: list) -> None:
    assert len(history(rows)) == 0
    pd.testing.assert_series_equal(history(rows).dtypes, history(ROWS).dtypes)


def test_a_stored_transport_has_the_history_of_its_acquisition(tmp_path) -> None:
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


def test_the_reports_tables_have_the_estimated_error(tmp_path) -> None:
    config = CONFIG.model_copy(
        update={
            "scenes": {"corner": CONFIG.scenes["corner"]},
            "methods": {name: CONFIG.methods[name] for name in ("low_rank", "symmetric")},
        }
    )
    acquired(tmp_path, config)
    build_report(config, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))
    history = open_transport(tmp_path / "corner" / "low_rank" / "transport.zarr").history
    tables, figures = tmp_path / "report" / "tables", tmp_path / "report" / "figures"
    (row, second_row) = pd.read_csv(tables / "results.csv").to_dict("records")
    estimated = history["estimated_error"].iloc[-1]
    assert row["estimated_error"] == pytest.approx(estimated, rel=1e-5)
    assert (row["target_error"], row["patterns"]) == (0.02, history["patterns"].iloc[-1])
    assert np.isnan(second_row["estimated_error"])
    assert (figures / "speed_error.png").is_file()
    assert pd.read_csv(tables / "levels.csv")["rank1"].max() > 1
