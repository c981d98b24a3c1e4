"""The section of a captured run's report on its rig: what the calibration found."""

from __future__ import annotations

import json

from rfpipe.report.blocks import Section, Table, Tabulation
from rfpipe.report.inputs import Inputs, Run
from rfpipe.rigs.calibrated import STANDINGS, VERDICTS_KEY, faults_of

__all__ = ["STANDING_COLOURS", "verdicts_of_run", "verdicts_section"]

STANDING_COLOURS = {
    "good": "#2f7d36",
    "NOT GOOD": "#c62828",
    "can't tell": "#d99a00",
    "NOT MEASURED": "#7b1f1f",
}
"""Colours of the verdicts, as they read."""


def verdicts_of_run(inputs: Inputs, run: Run) -> dict[str, dict[str, str]] | None:
    """Return the verdicts on the rig that captured a run, by the calibration's steps.

    None of a run that no rig of devices captured; {} of a rig that told of no calibration.
    """
    manifest = inputs.results / run.scene / run.method / "L00" / "capture.json"
    if not manifest.is_file():
        return None
    described = json.loads(manifest.read_text(encoding="utf-8")).get("rig", {})
    return dict(described.get(VERDICTS_KEY) or {}) if described.get("kind") == "devices" else None


def verdicts_section(inputs: Inputs) -> Section:
    """What the calibration found of the rig that captured the runs; no blocks without such one."""
    told: dict[str, list[Run]] = {}
    for run in inputs.runs:
        verdicts = verdicts_of_run(inputs, run)
        if verdicts is not None:
            told.setdefault(json.dumps(verdicts), []).append(run)
    text: list[str] = []
    blocks = []
    for same, runs in told.items():
        verdicts = json.loads(same)
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
        blocks.append(Tabulation("Verdicts", who, table, is_folded=False))
    return Section("calibration", "Calibration of the rig", blocks, text)
