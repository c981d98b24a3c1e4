"""Methods whose patterns are no unions of blocks, or not all, through the stages on files."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from tests.workflow.stagewise import CAMERA, SHAPE, Acquisition, matrix_rig

from rfpipe import acquire
from rfpipe.stages.plan import Plan

ASKED = {
    "hadamard": {},
    "benchmarks.rivals.low_rank:LowRank": {"patterns": 20},
    "near_far": {"patterns": 20},
    "symmetric": {"target_error": 0.02},
    "dual": {"target_error": 0.02},
}


@pytest.mark.parametrize("method", ASKED)
def test_the_files_hold_what_an_acquisition_in_process_finds(method: str, tmp_path: Path) -> None:
    acquisition = Acquisition(tmp_path, matrix_rig(noise=CAMERA))
    asked = ASKED[method]
    acquisition.plan = Plan(method, method, SHAPE, SHAPE, 1, asked)
    for level in acquisition.folder.levels():
        acquisition.level(level)
    stored = acquisition.assemble()
    result = acquire(
        acquisition.rig, method, progress=False, black_frames=2, floodlit_frames=2, **asked
    )
    expected, about = result.transport.pack()
    found, stored_about = stored.pack()
    assert stored_about == about
    assert set(found) == set(expected)
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)


def test_refining_tells_what_the_method_estimates(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "rfpipe")
    acquisition = Acquisition(tmp_path, matrix_rig(noise=CAMERA))
    acquisition.plan = Plan(
        "near_far", "near_far", SHAPE, SHAPE, 1, {"target_error": 1e-4, "patterns": 20}
    )
    for level in acquisition.folder.levels():
        acquisition.level(level)
    told = [record.message for record in caplog.records if "estimated" in record.message]
    assert told == [
        f"level {level}: estimated error {100 * error:.2f} % after {patterns} patterns, "
        "0.01 % asked for"
        for level, patterns, error in acquisition.assemble().history.itertuples(index=False)
    ]
    assert told
