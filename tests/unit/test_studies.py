"""The studies beside the configured scenes."""

import numpy as np
import pytest
from tests.helpers import settings_of_a_plane

from rfpipe.config import CameraConfig
from rfpipe.errors import InputError
from rfpipe.scenes import hard_cases
from rfpipe.stages.evaluating import studies
from rfpipe.stages.evaluating.studies import run_study
from rfpipe.stages.evaluating.studies.stability import stability_row
from rfpipe.store import open_arrays, read_manifest

CONFIG = settings_of_a_plane(report={"resolutions": [4, 8]})


def test_patterns_against_resolution_with_brute_force_computed():
    rows, arrays = run_study("resolution", CONFIG)
    assert arrays == {}
    found = {(row["method"], row["side"]): row for row in rows}
    assert set(found) == {
        (method, side)
        for method in ("brute_force", "near_far", "symmetric", "dual")
        for side in (4, 8)
    }
    assert found["brute_force", 8]["patterns"] == 64
    assert found["symmetric", 8]["patterns"] < found["dual", 8]["patterns"]
    assert found["symmetric", 8]["rms_total"] < 0.01


def test_brute_force_alone_is_computed_too():
    rows, _ = run_study(
        "resolution",
        settings_of_a_plane(report={"resolutions": [4, 8]}, methods={"brute_force": {}}),
    )
    assert [row["patterns"] for row in rows] == [16, 64]


@pytest.fixture(scope="module")
def mosaic():
    return run_study("mosaic", CONFIG)


def test_a_linear_interpolation_of_the_whole_bracket_loses_no_light(mosaic):
    rows, _ = mosaic
    (row,) = (r for r in rows if (r["chain"], r["normalization"]) == ("linear", "none"))
    assert row["energy"] == pytest.approx(1, abs=0.01)
    assert row["colour_contrast"] == pytest.approx(1, abs=0.01)


def test_median_interpolation_dims_and_pales_the_sum_and_normalization_restores_it(mosaic):
    """Fig. B.1."""
    rows, arrays = mosaic
    of_median = {row["normalization"]: row for row in rows if row["chain"] == "median"}
    assert of_median["none"]["energy"] < 0.95
    assert of_median["none"]["colour_contrast"] < 0.5
    for mode in ("per_channel", "total_energy"):
        assert of_median[mode]["rms"] < 1e-3
        np.testing.assert_allclose(
            arrays[f"sum_median_{mode}"], arrays["floodlit_median"], rtol=1e-3, atol=1e-4
        )
        assert of_median[mode]["image_error"] < of_median["none"]["image_error"]


def test_a_hard_case_is_compared_with_its_whole_matrix():
    row = stability_row("mirror", hard_cases()["mirror"](), "symmetric", None, CONFIG)
    assert row["matrix_error"] < 1e-6
    assert row["accumulation"] < 1e-6
    assert (row["rays"], row["camera"], row["refused"]) == (256, "exact", "")


def test_a_refused_acquisition_is_reported_and_not_raised():
    dark = hard_cases()["zero_transport"]()
    row = stability_row("zero_transport", dark, "symmetric", CameraConfig(), CONFIG)
    assert "all black" in row["refused"]
    assert row["patterns"] is None


def test_the_stage_writes_what_json_can_hold_and_works_once(tmp_path):
    manifest = tmp_path / "studies" / "resolution.json"
    studies.run("resolution", CONFIG, manifest, "code")
    rows = read_manifest(manifest)["rows"]
    assert rows[0]["method"] == "brute_force"
    assert rows[0]["rms_total"] is None  # NaN
    assert open_arrays(manifest.with_suffix(".zarr")).names == ()
    first = manifest.read_bytes()
    manifest.unlink()
    studies.run("resolution", CONFIG, manifest, "code")
    assert manifest.read_bytes() == first


def test_an_unknown_study_is_refused():
    with pytest.raises(InputError, match=r"'colours'.*resolution"):
        run_study("colours", CONFIG)
