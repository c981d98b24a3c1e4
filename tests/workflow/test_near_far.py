"""A run by near/far acquisition, up to its report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.workflow.harness import Workflow

from rfpipe import acquire, open_transport
from rfpipe.config import load_config
from rfpipe.photometry import sensor_from_config
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config

WEDGE = {
    "kind": "wedge",
    "surfaces": ["texture", "white"],
    "shape": [24, 26],
}


@pytest.mark.slow
def test_a_run_gives_the_transport_of_an_acquisition_in_process(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path)
    workflow.configure(scenes={"wedge": WEDGE}, methods={"near_far": {}})
    workflow.run()
    config = load_config(workflow.config)
    rig = SimulatedRig(
        scene_from_config(config.scenes["wedge"]), sensor_from_config(config.camera), config.seed
    )
    frames = {
        name: getattr(config.capture, name) for name in ("all_off_brackets", "all_on_brackets")
    }
    result = acquire(rig, "near_far", progress=False, **frames)
    stored = open_transport(workflow.path("wedge/near_far/transport.zarr"))
    expected, facts = result.transport.pack(config.storage.number_format)
    arrays, stored_facts = stored.pack(config.storage.number_format)
    assert stored_facts == facts
    assert set(arrays) == set(expected)
    for name, array in expected.items():
        np.testing.assert_array_equal(arrays[name], array, err_msg=name)
    pd.testing.assert_frame_equal(stored.history, result.history)

    page = workflow.path("report/index.html").read_text(encoding="utf-8")
    assert "near/far" in page.lower()
    table = pd.read_csv(workflow.path("report/tables/errors.csv"))
    assert set(table["method"]) == {"near_far"}
    assert (table["error"] < 0.05).all()
    assert "Nothing to be done" in workflow.run()
