"""A calibration's folder: written, read, and refused if incomplete."""

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.photometry import Resampling
from rfpipe.rigs.calibrated import ARRAYS, Calibration, load_calibration, write_calibration
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.store import write_arrays

WHOLE = Calibration(
    ProjectorLayout.grid((6, 8), (2, 3)),
    Resampling((2, 3), (2, 3), csr_array(np.eye(6, dtype=np.float32))),
    {"full_well_electrons": 9000.5},
    np.linspace(0, 1, 256) ** 2,
    {"dark": {"verdict": "good"}},
)


def test_a_calibration_is_read_as_written(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration", WHOLE)
    read = load_calibration(tmp_path / "calibration")
    assert np.array_equal(read.layout.ray_of_pixel, WHOLE.layout.ray_of_pixel)
    assert read.layout.shape == (2, 3)
    assert read.resampling.digest() == WHOLE.resampling.digest()
    assert np.array_equal(read.projector_response, WHOLE.projector_response)
    assert (read.camera, read.facts) == (WHOLE.camera, WHOLE.facts)


def test_missing_and_damaged_calibrations_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no complete calibration"):
        load_calibration(tmp_path)
    write_calibration(tmp_path, WHOLE)
    write_arrays(tmp_path / ARRAYS, {"black": np.zeros(3)}, {})
    with pytest.raises(IntegrityError, match="calibrate again"):
        load_calibration(tmp_path)
