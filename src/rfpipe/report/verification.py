"""What pictures that no method saw tell of a transport; devices and calibration of its rig."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from rfpipe.calibration.steps import STEPS
from rfpipe.report.drawing import Drawn, draw
from rfpipe.report.inputs import Inputs, Run, rig_of
from rfpipe.report.page import Block, Column, Illustration, Section, Table, table_of
from rfpipe.report.text import ERROR, number, percent
from rfpipe.rigs.calibrated import STANDINGS, VERDICTS_KEY, poor_verdicts


def verification_section(inputs: Inputs) -> Section | None:
    """What each transport is wrong by on pictures that were captured for this alone."""
    runs = [run for run in inputs.runs if run.verified]
    if not runs:
        return None
    shown = ("mean_error", "worst_error", "worst_picture", "noise", "drift", "moved", "saturated")
    about = [
        {
            "scene": run.scene,
            "method": run.method,
            "pictures": len(run.verified["pictures"]),
            **{name: run.verified[name] for name in (*shown, "samples")},
        }
        for run in runs
    ]
    blocks: list[Block] = [
        table_of(
            "Verification",
            "Pictures captured after the acquisition, beside what the transport makes of their "
            "patterns, on the rays that the camera knows, brightness brought to that at the "
            f"beginning, the captured pictures' noise taken off. {ERROR}. Changes, during the "
            "capture: the largest of a repeated random pattern, of its brightness, and beyond that "
            "and noise.",
            about,
            inputs.labels,
            [
                ("pictures", "pictures", number),
                ("mean error, %", "mean_error", percent),
                ("largest error, %", "worst_error", percent),
                ("under", "worst_picture", str),
                ("noise floor, %", "noise", percent),
                ("change of the lamp, %", "drift", percent),
                ("of the picture, %", "moved", percent),
                ("saturated samples", "saturated", number),
            ],
            csv="verification.csv",
            is_folded=False,
        ),
        *(_pictures(inputs, run) for run in runs),
        _picture_table(inputs, runs),
    ]
    title = "Verified by pictures that no method saw"
    return Section("verification", title, blocks)


def _picture_table(inputs: Inputs, runs: Sequence[Run]) -> Table:
    """Return the errors of each verification picture."""
    rows = [
        {"scene": run.scene, "method": run.method, **picture}
        for run in runs
        for picture in run.verified["pictures"]
    ]
    about = (
        f"{ERROR}. Plain error: relative to the picture's norm alone, which is larger for dark "
        "pictures."
    )
    columns: list[Column] = [
        ("error, %", "error", percent),
        ("standard error, %", "standard_error", percent),
        ("plain error, %", "plain_error", percent),
        ("noise floor, %", "noise", percent),
    ]
    labels: list[Column] = [*inputs.labels, ("picture", "name", str)]
    return table_of("Errors by picture", about, rows, labels, columns, csv="pictures.csv")


def summary(inputs: Inputs, run: Run) -> str:
    """Sum a run's verification up."""
    facts = run.verified
    return (
        f"{run.scene}, {inputs.title(run.method).lower()}: {len(facts['pictures'])} pictures are "
        f"relit to {percent(facts['mean_error'])} % on average, the worst, "
        f"{facts['worst_picture']}, to {percent(facts['worst_error'])} %; the noise floor is "
        f"{percent(facts['noise'])} %.{_within_bound(inputs, run)}"
    )


def _within_bound(inputs: Inputs, run: Run) -> str:
    bound = inputs.config.bound_of(run.scene, run.method)
    if bound is None or _is_above(inputs, run):
        return ""
    return f" This is within the {percent(bound)} % accepted."


def _is_above(inputs: Inputs, run: Run) -> bool:
    """Whether a verified error is above the one that is accepted, or not known."""
    bound, error = inputs.config.bound_of(run.scene, run.method), run.verified["mean_error"]
    return bound is not None and (error is None or error > bound)


def alarms_of(inputs: Inputs, run: Run) -> list[str]:
    """Return what was wrong with a run's capture, and a verified error above the accepted one."""
    if not run.verified:
        return []
    alarms = [f"NOTICED DURING THE CAPTURE, {alarm}." for alarm in run.verified["alarms"]]
    if _is_above(inputs, run):
        bound = percent(inputs.config.bound_of(run.scene, run.method))
        error = percent(run.verified["mean_error"])
        alarms.insert(0, f"ABOVE THE ACCEPTED ERROR: verified {error} %, {bound} % is accepted.")
    return alarms


def _pictures(inputs: Inputs, run: Run) -> Illustration:
    """Show each picture as captured and as relit, and their difference, two in a row."""
    assert run.verified_images is not None
    relit, captured = (run.verified_images.read(name) for name in ("relit", "captured"))
    radiance: dict[str, Any] = {}
    panels: list[Drawn] = []
    for index, picture in enumerate(run.verified["pictures"]):
        name, error = picture["name"], f"error {percent(picture['error'])} %"
        seen = run.panel(run.middle(captured[index]), name)
        made = run.panel(run.middle(relit[index]), "relit", error)
        slug = name.replace(" ", "_")
        radiance |= {f"{slug}_captured": seen.image, f"{slug}_relit": made.image}
        panels += [seen, made, made.less(seen)]
    figure = draw([panels[at : at + 6] for at in range(0, len(panels), 6)], 1.6)
    caption = "Each picture as captured, as relit, and the difference."
    slug = f"verified_{run.scene}_{run.method}"
    return Illustration(f"{run.scene}, {inputs.title(run.method)}", caption, slug, figure, radiance)


def verdicts_section(inputs: Inputs) -> Section:
    """What the calibration found of the rig that captured the runs; no blocks without such one."""
    groups: dict[str, list[str]] = {}
    for run in inputs.runs:
        rig = rig_of(inputs.results, run)
        if rig.get("kind") == "devices":
            verdicts = json.dumps(rig.get(VERDICTS_KEY) or {})
            groups.setdefault(verdicts, []).append(f"{run.scene} by {run.method}")
    text: list[str] = []
    blocks = []
    for same, runs in groups.items():
        stated, who = json.loads(same), ", ".join(runs)
        # as steps are done: manifests sort their names
        known = [step for step in STEPS if step in stated]
        steps = {step: stated[step] for step in dict.fromkeys([*known, *stated])}
        text += [f"{who}: {fault}" for fault in poor_verdicts(steps)]
        rows = [[one["title"], STANDINGS[one["standing"]]] for one in steps.values()]
        if not rows:
            rows = [["no calibration", STANDINGS["unknown"]]]
            text.append(f"{who}: without a calibration; pictures may not be radiance.")
        table = Table("Verdicts", who, ["step", "verdict"], rows, 2, is_folded=False)
        blocks.append(table)
    return Section("calibration", "Calibration of the rig", blocks, text)
