"""The section of a captured run's report on its rig: what the calibration found."""

from __future__ import annotations

import json

from rfpipe.report.blocks import Section, Table, Tabulation
from rfpipe.report.inputs import Inputs, Run
from rfpipe.rigs.verdicts import STANDINGS, VERDICTS_KEY, faults_of

__all__ = ["STANDING_COLOURS", "verdicts_of_run", "verdicts_section"]

STANDING_COLOURS = {
    "good": "#2f7d36",
    "NOT GOOD": "#c62828",
    "can't tell": "#d99a00",
    "NOT MEASURED": "#7b1f1f",
}
"""Colours of the verdicts, as they read."""


def verdicts_of_run(inputs: Inputs, run: Run) -> dict[str, dict[str, str]]:
    """Return the verdicts on the rig that captured a run, by the calibration's steps; may be {}."""
    manifest = inputs.results / run.scene / run.method / "L00" / "capture.json"
    if not manifest.is_file():
        return {}
    described = json.loads(manifest.read_text(encoding="utf-8")).get("rig", {})
    return dict(described.get(VERDICTS_KEY) or {})


def verdicts_section(inputs: Inputs) -> Section:
    """What the calibration found of the rig that captured the runs."""
    found = {run: verdicts_of_run(inputs, run) for run in inputs.runs}
    told: dict[str, list[Run]] = {}
    for run, verdicts in found.items():
        told.setdefault(json.dumps(verdicts), []).append(run)
    text, blocks = [], []
    for runs in told.values():
        verdicts = found[runs[0]]
        who = ", ".join(f"{run.title} by {run.method_title.lower()}" for run in runs)
        if not verdicts:
            text.append(
                f"{who}: the rig told of no calibration; whether its pictures are radiance is not "
                "known."
            )
        text += [f"{who}: {fault}" for fault in faults_of(verdicts)]
        rows = [[one["title"], STANDINGS[one["standing"]]] for one in verdicts.values()]
        rows = rows or [["no calibration", STANDINGS["unknown"]]]
        table = Table([], ["step", "verdict"], rows, text_columns=2)
        sources = [f"{run.scene}/{run.method}/L00/capture.json" for run in runs]
        blocks.append(Tabulation("Verdicts", who, table, is_folded=False, sources=sources))
    return Section("calibration", "Calibration of the rig", blocks, text, inputs.run_sources)
