"""The tables of errors, and of errors against patterns."""

import csv
import math

import numpy as np
import pandas as pd
import pytest

from rfpipe.stages import evaluate
from rfpipe.store import write_arrays, write_manifest


def test_errors_are_blank_where_they_are_undefined(tmp_path):
    """A pattern that lights everything has no unlit pixels: a blank in the table, no crash."""
    lit = np.ones((1, 2, 3), np.float32)
    truth = np.ones((1, 2, 3, 3), np.float32)
    levels = np.stack([2 * truth[0], truth[0], 1.5 * truth[0]])
    arrays = {"patterns": lit, "truth": truth, "relit": 1.5 * truth, "floodlit_truth": truth[0]}
    write_arrays(tmp_path / "relight.zarr", arrays | {"levels_relit": levels}, {})
    rows = [{"level": level, "patterns": shown} for level, shown in enumerate((1, 0, 2))]
    facts = {"scene": "box", "method": "dual", "names": ["everything"], "coaxial": True}
    write_manifest(tmp_path / "relight.json", {**facts, "levels": rows})
    errors, speed = tmp_path / "tables" / "errors.csv", tmp_path / "tables" / "speed_error.csv"
    evaluate.run([tmp_path / "relight.json"], errors, speed, 2.0)

    (row,) = csv.DictReader(errors.read_text().splitlines())
    assert (row["scene"], row["method"], row["pattern"]) == ("box", "dual", "everything")
    assert float(row["rms_total"]) == pytest.approx(0.5)
    assert row["rms_unlit"] == ""
    assert float(row["psnr_db"]) == pytest.approx(10 * math.log10(1 / 0.25), abs=1e-3)
    by_level = pd.read_csv(speed)[["level", "patterns", "capture_s", "error"]]
    assert by_level.to_numpy().tolist() == [[0, 1, 2, 1], [2, 3, 6, 0.5]]
