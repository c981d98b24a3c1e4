"""The thesis' figures, tiny, through the workflow: none missing, none blank."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.workflow.harness import Workflow

from rfpipe.errors import StoreError
from rfpipe.report import check_report
from rfpipe.report.thesis import CLAIMS

pytest.importorskip("mitsuba")

_PLANE = {"shape": [8, 9], "sweep": False}
_SCENES = {
    "planes_i": {"kind": "plane", "surfaces": ["texture"], **_PLANE},
    "planes_iv": {"kind": "wedge", "surfaces": ["texture", "texture"], **_PLANE},
    "light_field": {
        "kind": "room",
        "surfaces": ["texture", "white", "white"],
        "shape": [4, 6],
        "views": [2, 2],
        "methods": {"symmetric": {}},
        "sweep": False,
    },
}
# Beside the physically based figures, of which one page shows some twice.
_PATIENCE_SECONDS = 1200.0  # each study traces, and compiles, its own scenes
_TABLES = {"Table 3.1", "Table 5.1"}


def test_make_figures_leaves_no_figure_missing_or_blank(tmp_path: Path) -> None:
    """Every figure and table that the thesis has stands in the results, and is drawn."""
    workflow = Workflow(tmp_path)
    workflow.configure(
        scenes=_SCENES,
        methods={"symmetric": {}, "dual": {}},
        report={
            "resolutions": [4, 8],
            "figures": {"side": 8, "samples": 32, "positions": 3},
        },
    )
    process = workflow.start()
    output, _ = process.communicate(timeout=_PATIENCE_SECONDS)
    assert process.returncode == 0, output
    page = workflow.path("report")
    results = check_report(page)
    of_thesis = {figure.thesis.name for figure in results.figures if figure.thesis}
    assert of_thesis >= set(CLAIMS) - _TABLES
    titles = {section.title for section in results.sections}
    assert {
        "The thesis' claims, and what holds here",
        "Tables 3.1 and 5.1 on physically based scenes",
    } <= titles
    rows = json.loads((page.parent / "studies" / "arc.json").read_text())["rows"]
    assert rows[0]["positions"] == 3

    (page / "figures" / "fig_3_6.png").unlink()
    with pytest.raises(StoreError, match="fig_3_6"):
        check_report(page)
