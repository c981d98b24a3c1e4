"""The thesis' figures, tiny, through the workflow: none missing, none blank."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from tests.workflow.harness import Workflow

from rfpipe.errors import StoreError
from rfpipe.report import check_report
from rfpipe.report.entries import TableEntry
from rfpipe.report.thesis import CLAIMS

_PLANE = {"shape": [8, 9], "sweep": False}
_SYMMETRIC = {"methods": {"symmetric": {}}}  # the one scene tells dual photography's figures
_SCENES = {
    "planes_i": {"kind": "plane", "surfaces": ["texture"], **_PLANE, **_SYMMETRIC},
    "planes_iv": {"kind": "wedge", "surfaces": ["texture", "texture"], **_PLANE},
    "planes_ii": {"kind": "wedge", "surfaces": ["white", "white"], **_PLANE, **_SYMMETRIC},
}
# Beside the physically based figures, of which one page shows some twice.
_PATIENCE_SECONDS = 1200.0  # each study traces, and compiles, its own scenes
_TABLES = ["Table 3.1", "Table 5.1"]


def test_without_llvm_make_figures_says_what_to_install_before_its_first_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "none")
    workflow = Workflow(tmp_path, {"report": {"figures": {}}})
    assert "apt-get install libllvm19" in workflow.run(succeeds=False)
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
@pytest.mark.needs("llvm")
def test_make_figures_leaves_no_figure_missing_or_blank(tmp_path: Path, studies: Workflow) -> None:
    """Every figure and table that the thesis has stands in the results, and is drawn."""
    workflow = Workflow(tmp_path)
    workflow.take_studies(studies)  # those behind the thesis' figures are made here
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
    assert of_thesis >= set(CLAIMS) - set(_TABLES)
    tables = [entry for section in results.sections for entry in section.content
              if isinstance(entry, TableEntry)]  # fmt: skip
    assert sorted(entry.thesis.name for entry in tables if entry.thesis) == _TABLES
    judged = pd.read_csv(page / "tables" / "claims.csv")
    assert set(judged["figure"]) >= {*CLAIMS} - {"Fig. 3.2"}  # too few pixels to tell
    assert len(pd.read_csv(page / "tables" / "table_3_1.csv")) == 5
    titles = {section.title for section in results.sections}
    assert {
        "The thesis' claims, and what holds here",
        "Size, time and patterns (Tables 3.1 and 5.1)",
        "Hard cases",
    } <= titles
    rows = json.loads((page.parent / "studies" / "arc.json").read_text())["rows"]
    assert rows[0]["positions"] == 3
    _check_stops(json.loads((page.parent / "studies" / "faults.json").read_text())["rows"])

    (page / "figures" / "fig_3_6.png").unlink()
    with pytest.raises(StoreError, match="fig_3_6"):
        check_report(page)


def _check_stops(rows: list[dict[str, Any]]) -> None:
    """Stopped acquisitions went on to the same bytes, damaged ones and second runs were refused."""
    told = {row["case"]: row["happened"] for row in rows}
    for stop in ("Ctrl-C", "SIGTERM", "kill -9", "full disk"):
        assert "the same bytes" in told[stop]
    assert told["full disk"].startswith("refused to go on")
    assert "a process is writing this store" in told["two runs in one folder"]
    for damage in ("truncated", "altered", "missing"):
        assert "missing, truncated or altered" in told[f"{damage} chunk"]
