"""A user-defined method in one file outside the package, selected by settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.workflow.harness import Workflow

from rfpipe import OperatorRig, acquire, open_transport
from rfpipe.errors import InputError
from rfpipe.methods import get_method
from rfpipe.store import read_manifest
from rfpipe.testing import MethodContract

EXAMPLE = Path(__file__).parents[1] / "examples" / "column_scan.py"


class TestColumnScan(MethodContract):
    error = 1.0  # it doesn't separate the rays of a column
    floodlit_error = 1e-5

    def make_method(self):
        return get_method(f"{EXAMPLE}:ColumnScan")


@pytest.mark.slow
def test_it_runs_in_the_workflow_with_rfpipe_s_own(of_ones_own: Workflow) -> None:
    workflow = of_ones_own
    page = workflow.path("report/index.html").read_text(encoding="utf-8")
    assert "Scan of columns" in page
    for name, patterns in (("wide", 4), ("module", 8)):
        manifest = read_manifest(workflow.path(f"tiny/{name}/transport.json"))
        assert manifest["patterns"] == patterns
    truth = open_transport(workflow.path("tiny/brute_force/transport.zarr"))
    bars = np.zeros((8, 8), np.float32)
    bars[:, 2:4] = 1
    expected = truth.relight(bars)
    relit = open_transport(workflow.path("tiny/wide/transport.zarr")).relight(bars)
    assert np.linalg.norm(relit - expected) < 0.02 * np.linalg.norm(expected)


def test_it_runs_in_process_by_path_class_or_instance() -> None:
    rig = OperatorRig(np.eye(6), (2, 3), (2, 3))
    path = f"{EXAMPLE}:ColumnScan"
    method = get_method(path)
    runs = [acquire(rig, it, progress=False, width=3) for it in (path, type(method), method)]
    assert [run.patterns for run in runs] == [1, 1, 1]
    with pytest.raises(InputError, match=r"width is 0; it should be at least 1"):
        acquire(rig, path, progress=False, width=0)
    with pytest.raises(InputError, match="tolerance is unknown"):
        acquire(rig, path, progress=False, tolerance=0.1)
