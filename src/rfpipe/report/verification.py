"""Verification of transports by separate pictures, and the calibration of their rigs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from rfpipe.calibration.steps import STEPS
from rfpipe.report.drawing import Drawn, draw
from rfpipe.report.inputs import RelitAcquisition, ReportInputs, rig_of
from rfpipe.report.page import Block, Column, Illustration, Section, Table, table_of
from rfpipe.report.text import ERROR, number, rounded_percent
from rfpipe.rigs.calibrated import STANDINGS, VERDICTS_KEY, poor_verdicts


def verification_section(inputs: ReportInputs) -> Section | None:
    """Return the section of errors in verification pictures; None without such pictures."""
    runs = [run for run in inputs.runs if run.verified]
    if not runs:
        return None
    blocks: list[Block] = [
        _error_table(inputs, runs),
        *(_pictures(inputs, run) for run in runs),
        _picture_table(inputs, runs),
    ]
    return Section("verification", "Verification by separate pictures", blocks)


def _error_table(inputs: ReportInputs, runs: Sequence[RelitAcquisition]) -> Table:
    """Return the table of errors in verification pictures and of changes during the capture."""
    names = ("mean_error", "worst_error", "worst_picture", "noise", "drift", "moved", "saturated")
    rows = [
        {
            "scene": run.scene,
            "method": run.method,
            "pictures": len(run.verified["pictures"]),
            **{name: run.verified[name] for name in (*names, "samples")},
        }
        for run in runs
    ]
    caption = (
        "Error of relit pictures relative to pictures captured after the acquisition, which no "
        "method uses, on unmasked rays. Brightness is corrected for drift of the lamp; the noise "
        f"of the captured pictures is subtracted. {ERROR}. Largest changes during the capture, "
        "from check pictures: of the lamp's brightness, and of the picture beyond brightness and "
        "noise."
    )
    columns: list[Column] = [
        ("pictures", "pictures", number),
        ("mean error, %", "mean_error", rounded_percent),
        ("largest error, %", "worst_error", rounded_percent),
        ("in picture", "worst_picture", str),
        ("noise floor, %", "noise", rounded_percent),
        ("change of the lamp, %", "drift", rounded_percent),
        ("change of the picture, %", "moved", rounded_percent),
        ("saturated samples", "saturated", number),
    ]
    return table_of(
        "Verification", caption, rows, inputs.labels, columns,
        csv="verification.csv", is_folded=False,
    )  # fmt: skip


def _picture_table(inputs: ReportInputs, runs: Sequence[RelitAcquisition]) -> Table:
    """Return the errors of each verification picture."""
    rows = [
        {"scene": run.scene, "method": run.method, **picture}
        for run in runs
        for picture in run.verified["pictures"]
    ]
    caption = (
        f"{ERROR}. Plain error: relative to the picture's norm alone, which is larger for dark "
        "pictures."
    )
    columns: list[Column] = [
        ("error, %", "error", rounded_percent),
        ("standard error, %", "standard_error", rounded_percent),
        ("plain error, %", "plain_error", rounded_percent),
        ("noise floor, %", "noise", rounded_percent),
    ]
    labels: list[Column] = [*inputs.labels, ("picture", "name", str)]
    return table_of("Errors by picture", caption, rows, labels, columns, csv="pictures.csv")


def summary(inputs: ReportInputs, run: RelitAcquisition) -> str:
    """Return a sentence on a run's verification."""
    facts = run.verified
    name = f"{run.scene}, {inputs.title(run.method).lower()}"
    mean, largest = rounded_percent(facts["mean_error"]), rounded_percent(facts["worst_error"])
    return (
        f"{name}: the mean error of {len(facts['pictures'])} relit pictures is {mean} %; the "
        f"largest, of {facts['worst_picture']}, is {largest} %; the noise floor is "
        f"{rounded_percent(facts['noise'])} %.{_within_bound(inputs, run)}"
    )


def _within_bound(inputs: ReportInputs, run: RelitAcquisition) -> str:
    bound = inputs.config.bound_of(run.scene, run.method)
    if bound is None or _is_above(inputs, run):
        return ""
    return f" This is within the {rounded_percent(bound)} % accepted."


def _is_above(inputs: ReportInputs, run: RelitAcquisition) -> bool:
    """Test whether the measured error exceeds the accepted error, or is unknown."""
    bound, error = inputs.config.bound_of(run.scene, run.method), run.verified["mean_error"]
    return bound is not None and (error is None or error > bound)


def alarms_of(inputs: ReportInputs, run: RelitAcquisition) -> list[str]:
    """Return sentences on changes during the capture, and on an error above the accepted one."""
    if not run.verified:
        return []
    alarms = [f"NOTICED DURING THE CAPTURE, {alarm}." for alarm in run.verified["alarms"]]
    if _is_above(inputs, run):
        bound = rounded_percent(inputs.config.bound_of(run.scene, run.method))
        error = rounded_percent(run.verified["mean_error"])
        alarms.insert(0, f"ABOVE THE ACCEPTED ERROR: verified {error} %, {bound} % is accepted.")
    return alarms


def _pictures(inputs: ReportInputs, run: RelitAcquisition) -> Illustration:
    """Draw each picture as captured and as relit, and their difference, two pictures in a row."""
    assert run.verified_images is not None
    relit, captured = (run.verified_images.read(name) for name in ("relit", "captured"))
    radiance: dict[str, Any] = {}
    panels: list[Drawn] = []
    for index, picture in enumerate(run.verified["pictures"]):
        name, error = picture["name"], f"error {rounded_percent(picture['error'])} %"
        captured_panel = run.panel(run.middle(captured[index]), name)
        relit_panel = run.panel(run.middle(relit[index]), "relit", error)
        slug = name.replace(" ", "_")
        radiance |= {
            f"{slug}_captured": captured_panel.image,
            f"{slug}_relit": relit_panel.image,
        }
        panels += [captured_panel, relit_panel, relit_panel.less(captured_panel)]
    figure = draw([panels[at : at + 6] for at in range(0, len(panels), 6)], 1.6)
    caption = "Each picture as captured, as relit, and the difference."
    slug = f"verified_{run.scene}_{run.method}"
    return Illustration(f"{run.scene}, {inputs.title(run.method)}", caption, slug, figure, radiance)


def verdicts_section(inputs: ReportInputs) -> Section:
    """Return the section of the rigs' calibrations; it has no blocks for simulated rigs."""
    groups: dict[str, list[str]] = {}
    for run in inputs.runs:
        rig = rig_of(inputs.results, run)
        if rig.get("kind") == "devices":
            verdicts = json.dumps(rig.get(VERDICTS_KEY) or {})
            groups.setdefault(verdicts, []).append(f"{run.scene} by {run.method}")
    text: list[str] = []
    blocks = []
    for verdicts_text, runs in groups.items():
        verdicts, names = json.loads(verdicts_text), ", ".join(runs)
        # in the order of the steps: manifests sort their names
        known = [step for step in STEPS if step in verdicts]
        steps = {step: verdicts[step] for step in dict.fromkeys([*known, *verdicts])}
        text += [f"{names}: {fault}" for fault in poor_verdicts(steps)]
        rows = [[step["title"], STANDINGS[step["standing"]]] for step in steps.values()]
        if not rows:
            rows = [["no calibration", STANDINGS["unknown"]]]
            text.append(f"{names}: without a calibration; pictures may not be radiance.")
        table = Table("Verdicts", names, ["step", "verdict"], rows, 2, is_folded=False)
        blocks.append(table)
    return Section("calibration", "Calibration of the rig", blocks, text)
