"""The sweep of tolerances, and its evaluation."""

import csv
import math
import shutil

import numpy as np
import pandas as pd
import pytest

from rfpipe.config import Config
from rfpipe.stages.acquire import acquire
from rfpipe.stages.evaluating import evaluate, sweep
from rfpipe.stages.evaluating.evaluate import error_rows
from rfpipe.stages.evaluating.sweep import stored
from rfpipe.stages.settings import acquire_options
from rfpipe.stages.verifying.verify import verify
from rfpipe.store import open_arrays, read_manifest, write_arrays, write_manifest
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.dense import DenseTransport

CONFIG = Config.model_validate(
    {
        "scenes": {"corner": {"kind": "wedge", "surfaces": ["white", "texture"],
                              "shape": [8, 10]}},
        "methods": {"symmetric": {}},
        "report": {"trials": {"symmetric": [0.03, 0.003]}},
    }
)  # fmt: skip


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    sweep.run(CONFIG, "corner", "symmetric", folder, "code")
    return folder


def test_a_smaller_tolerance_takes_more_patterns_and_bytes(swept):
    rows = read_manifest(swept / "sweep.json")["rows"]
    assert [(row["option"], row["value"]) for row in rows] == [
        ("tolerance", 0.03),
        ("tolerance", 0.003),
    ]
    assert rows[0]["patterns"] < rows[1]["patterns"]
    assert rows[0]["bytes"] < rows[1]["bytes"]
    relit = open_arrays(swept / "sweep.zarr").read("relit")
    assert relit.shape == (2, 6, 8, 10, 3)
    assert np.isfinite(relit).all()


def test_times_stand_apart_from_the_manifest_which_is_the_same_in_every_run(swept, tmp_path):
    sweep.run(CONFIG, "corner", "symmetric", tmp_path, "code")
    assert (tmp_path / "sweep.json").read_bytes() == (swept / "sweep.json").read_bytes()
    with (tmp_path / "sweep.csv").open() as file:
        times = list(csv.DictReader(file))
    assert [float(row["value"]) for row in times] == [0.03, 0.003]
    assert all(float(row["processing_s"]) > 0 for row in times)


def test_a_sweep_that_is_stopped_keeps_its_points(swept, tmp_path, monkeypatch):
    acquired = []

    def counted(rig, *method, **options):
        acquired.append(options.get("tolerance"))
        if acquired == [None, 0.03, 0.003]:  # the first is to load the kernels
            raise KeyboardInterrupt
        return acquire(rig, *method, **options)

    monkeypatch.setattr("rfpipe.stages.acquire.acquire", counted)
    with pytest.raises(KeyboardInterrupt):
        sweep.run(CONFIG, "corner", "symmetric", tmp_path, "code")
    assert verify(tmp_path).findings == []
    sweep.run(CONFIG, "corner", "symmetric", tmp_path, "code")
    assert acquired == [None, 0.03, 0.003, None, 0.003]
    assert (tmp_path / "sweep.json").read_bytes() == (swept / "sweep.json").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in swept.iterdir()}


def test_settings_of_the_acquisition_are_passed_on():
    changed = CONFIG.model_copy(update={"normalization": "none"})
    options = acquire_options(changed, "symmetric", changed.methods["symmetric"])
    assert options["normalization"] == "none"
    assert options["black_frames"] == CONFIG.capture.black_frames
    assert (options["method"], options["tolerance"]) == ("symmetric", 1e-3)


def test_bytes_and_numbers_are_those_of_the_same_transport_on_disk(tmp_path):
    matrix = np.arange(48, dtype=np.float32).reshape(1, 6, 8)
    transport = DenseTransport((2, 3), (2, 4), 1, [], {"matrix": matrix})
    save_transport(transport, tmp_path / "transport.zarr", "uint8")
    with stored(transport, "uint8") as kept:
        assert kept.nbytes == open_transport(tmp_path / "transport.zarr").nbytes
        np.testing.assert_array_equal(kept.relight(np.eye(2, 4)), transport.relight(np.eye(2, 4)))


def test_errors_are_blank_where_they_are_undefined(swept, tmp_path):
    """A pattern that lights everything has no unlit pixels: a blank in the table, no crash."""
    lit = np.ones((1, 2, 3), np.float32)
    truth = np.ones((1, 2, 3, 3), np.float32)
    arrays = {"patterns": lit, "truth": truth, "relit": 1.5 * truth, "floodlit_truth": truth[0]}
    write_arrays(tmp_path / "relight.zarr", arrays, {})
    facts = {"scene": "box", "method": "dual", "names": ["everything"], "coaxial": True}
    write_manifest(tmp_path / "relight.json", facts)
    write_arrays(tmp_path / "sweep.zarr", {"relit": truth[None]}, {})
    rows = [{"option": "tolerance", "value": 0.01, "patterns": 3, "bytes": 99}]
    write_manifest(tmp_path / "sweep.json", {"scene": "box", "method": "dual", "rows": rows})
    (tmp_path / "sweep.csv").write_text("value,processing_s,simulation_s\n0.01,0.5,0.25\n")
    errors, speed = tmp_path / "tables" / "errors.csv", tmp_path / "tables" / "speed_error.csv"
    evaluate.run([tmp_path / "relight.json"], [tmp_path / "sweep.json"], errors, speed, 2.0)

    (row,) = csv.DictReader(errors.read_text().splitlines())
    assert (row["scene"], row["method"], row["pattern"]) == ("box", "dual", "everything")
    assert float(row["rms_total"]) == pytest.approx(0.5)
    assert row["rms_unlit"] == ""
    assert float(row["psnr_db"]) == pytest.approx(10 * math.log10(1 / 0.25), abs=1e-3)
    (row,) = pd.read_csv(speed).to_dict("records")
    assert (row["patterns"], row["bytes"], row["capture_s"]) == (3, 99, 6.0)
    assert (row["processing_s"], row["rms_total"]) == (0.5, 0)
    assert row["psnr_db"] == math.inf


def test_error_rows_name_each_pattern():
    patterns = np.zeros((2, 1, 2))
    patterns[:, 0, 0] = 1
    truth = np.array([[[[1.0], [0.1]]], [[[1.0], [0.2]]]])
    relit = np.array([[[[1.0], [0.1]]], [[[1.0], [0.3]]]])
    first, second = error_rows(relit, truth, patterns, ["one", "two"], white=1.0)
    assert (first["pattern"], first["rms_unlit"]) == ("one", 0)
    assert second["rms_unlit"] == pytest.approx(0.5)
    assert second["ciede2000"] > first["ciede2000"] == 0


def test_an_altered_table_of_times_is_found(swept, tmp_path):
    folder = tmp_path / "results" / "corner" / "symmetric"
    shutil.copytree(swept, folder)
    assert verify(folder).findings == []
    (folder / "sweep.csv").write_text("value\n1\n")
    (finding,) = verify(folder).findings
    assert finding.path == folder / "sweep.csv"
    assert {path.name for path in finding.mend.remove} == {
        "sweep.json", "sweep.zarr", "sweep.csv", "sweep_times.json",
    }  # fmt: skip
