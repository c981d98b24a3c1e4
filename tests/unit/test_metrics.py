"""Error metrics and their tables, compared with values computed by hand."""

import csv
import math

import numpy as np
import pandas as pd
import pytest

from rfpipe.errors import InputError
from rfpipe.stages import evaluate
from rfpipe.stages.evaluate import colour_difference, relative_rms
from rfpipe.store import write_arrays, write_manifest


def image(*values: float) -> np.ndarray:
    """One row of grey pixels, (1, n, 1)."""
    return np.array(values, np.float32).reshape(1, -1, 1)


def test_relative_rms_is_the_norm_of_the_difference_over_that_of_the_truth():
    assert relative_rms(image(3, 0), image(0, 4)) == pytest.approx(5 / 4)
    assert relative_rms(image(1, 2), image(1, 2)) == 0
    assert math.isnan(relative_rms(image(1, 2), image(0, 0)))
    truth = np.full((64, 64, 1), 1e-30, np.float32)  # its squares underflow in float32
    assert relative_rms(2 * truth, truth) == pytest.approx(1)


def test_images_of_different_shape_are_refused():
    with pytest.raises(InputError, match="can't be compared"):
        relative_rms(image(1, 2), image(1))


def test_colour_difference_of_greys_follows_lightness():
    # Between white and the grey of half its light L* falls from 100 to 76.07; CIEDE2000 divides
    # the fall by S_L = 1 + 0.015 (L - 50)^2 / sqrt(20 + (L - 50)^2) at the mean L of 88.03.
    lightness = 116 * 0.5 ** (1 / 3) - 16
    middle = (100 + lightness) / 2 - 50
    expected = (100 - lightness) / (1 + 0.015 * middle**2 / math.sqrt(20 + middle**2))
    assert colour_difference(image(2.0), image(4.0), white=4.0) == pytest.approx(expected, rel=1e-3)


def test_colour_difference_depends_on_hue_and_clips_negative_light():
    red, dark = np.array([[[1.0, 0.0, 0.0]]]), np.array([[[0.0, 0.0, 0.0]]])
    assert colour_difference(red, red[..., ::-1], white=1.0) > 20
    assert colour_difference(dark - 1e-3, dark, white=1.0) == 0


def test_colour_difference_refuses_other_channels_and_has_no_value_without_white():
    two = np.zeros((1, 1, 2))
    with pytest.raises(InputError, match="2 channels"):
        colour_difference(two, two, white=1.0)
    assert math.isnan(colour_difference(image(1.0), image(1.0), white=0.0))


def test_errors_are_blank_where_they_are_undefined(tmp_path):
    """A pattern that lights everything has no unlit pixels: a blank in the table, no crash."""
    lit = np.ones((1, 2, 3), np.float32)
    truth = np.ones((1, 2, 3, 3), np.float32)
    arrays = {"patterns": lit, "truth": truth, "relit": 1.5 * truth, "floodlit_truth": truth[0]}
    write_arrays(tmp_path / "relight.zarr", arrays, {})
    rows = [{"level": level, "patterns": shown} for level, shown in enumerate((1, 0, 2))]
    facts = {"scene": "box", "method": "dual", "names": ["everything"], "coaxial": True}
    errors = {"errors": {"spots": 0.1}, "level_errors": [1, 0.8, 0.5]}
    write_manifest(tmp_path / "relight.json", {**facts, **errors, "levels": rows})
    errors, speed = tmp_path / "tables" / "errors.csv", tmp_path / "tables" / "speed_error.csv"
    for level, count in enumerate((5, 0, 4)):  # as if they included references
        (tmp_path / f"L{level:02}").mkdir()
        facts = {"patterns": count, "shape": [count, 1, 2, 3, 3]}
        write_manifest(tmp_path / f"L{level:02}/capture.json", facts)
    evaluate.run([tmp_path / "relight.json"], errors, speed, 2.0)

    spots, row = csv.DictReader(errors.read_text().splitlines())
    assert (spots["pattern"], spots["error"], spots["ciede2000"]) == ("spots", "0.1", "")
    assert (row["scene"], row["method"], row["pattern"]) == ("box", "dual", "everything")
    assert float(row["error"]) == pytest.approx(0.5)
    assert row["indirect_error"] == ""
    by_level = pd.read_csv(speed)[["level", "patterns", "pictures", "capture_s", "error"]]
    assert by_level.to_numpy().tolist() == [[0, 1, 5, 2 * 5, 1], [2, 3, 9, 2 * 9, 0.5]]
