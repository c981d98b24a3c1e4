"""What pictures that no method saw tell of a transport; devices and calibration of its rig."""

from __future__ import annotations

import json
from typing import Any

from rfpipe.report.drawing import draw
from rfpipe.report.inputs import Inputs, Run, rig_of
from rfpipe.report.page import Block, Gallery, Illustration, Section, Table, table_of
from rfpipe.report.text import ERROR, number, percent
from rfpipe.rigs.calibrated import STANDINGS, VERDICTS_KEY, faults_of


def verification_section(inputs: Inputs) -> Section | None:
    """What each transport is wrong by on pictures that were captured for this alone."""
    runs = [run for run in inputs.runs if run.verified]
    if not runs:
        return None
    about = [{"scene": run.scene, "method": run.method, **run.verified} for run in runs]
    blocks: list[Block] = [
        table_of(
            "Verification",
            "Pictures captured after the acquisition, beside what the transport makes of their "
            f"patterns, on the rays that the camera knows, brightness brought to that at the "
            f"beginning, the captured pictures' noise taken off. {ERROR}.",
            [{**row, "pictures": len(row["pictures"])} for row in about],
            inputs.labels,
            [
                ("pictures", "pictures", number),
                ("mean error, %", "mean_error", percent),
                ("largest error, %", "worst_error", percent),
                ("under", "worst_picture", str),
                ("noise floor, %", "noise", percent),
            ],
            is_folded=False,
        ),
        *(Gallery(_pictures(inputs, run)) for run in runs),
        table_of(
            "The rig during the capture",
            "Largest change of a repeated random pattern: of its brightness, and beyond that and "
            "noise. A dash: not measured.",
            [_of_the_rig(run) for run in runs],
            inputs.labels,
            [
                ("change of the lamp, %", "drift", percent),
                ("of the picture, %", "moved", percent),
                ("saturated samples", "saturated", number),
                ("saturated, %", "saturated_share", percent),
            ],
            csv="verification_rig.csv",
            is_folded=False,
        ),
    ]
    title = "Verified by pictures that no method saw"
    text = [sentence for run in runs for sentence in _text(inputs, run)]
    return Section("verification", title, blocks, text)


def _text(inputs: Inputs, run: Run) -> list[str]:
    """Sum a verification up, with all that was wrong."""
    bound, facts = inputs.config.verification.fail_above, run.verified
    text = (
        f"{run.scene}, {inputs.title(run.method).lower()}: {len(facts['pictures'])} pictures are "
        f"relit to {percent(facts['mean_error'])} % on average, the worst, "
        f"{facts['worst_picture']}, to {percent(facts['worst_error'])} %; the noise floor is "
        f"{percent(facts['noise'])} %."
    )
    if bound is not None:
        is_above = facts["mean_error"] is None or facts["mean_error"] > bound
        text += " THIS IS ABOVE the " if is_above else " It is not above the "
        text += f"{percent(bound)} % that was accepted."
    return [text, *(f"NOTICED DURING THE CAPTURE, {alarm}." for alarm in facts["alarms"])]


def _of_the_rig(run: Run) -> dict[str, Any]:
    facts = run.verified
    return {
        "scene": run.scene,
        "method": run.method,
        **{name: facts[name] for name in ("drift", "moved", "saturated")},
        "saturated_share": facts["saturated"] / max(facts["samples"], 1),
    }


def _pictures(inputs: Inputs, run: Run) -> list[Illustration]:
    """Show each picture as relit and as captured, and their difference."""
    assert run.verified_images is not None
    relit, captured = (run.verified_images.read(name) for name in ("relit", "captured"))
    illustrations = []
    for index, picture in enumerate(run.verified["pictures"]):
        light = [
            run.panel(run.middle(images[index]), title)
            for images, title in ((relit, "relit"), (captured, "captured"))
        ]
        caption = (
            f"{inputs.title(run.method)}: error {percent(picture['error'])} % (noise floor "
            f"{percent(picture['noise'])} %)."
        )
        slug = f"verified_{run.scene}_{run.method}_{picture['name'].replace(' ', '_')}"
        figure = draw([[*light, light[0].less(light[1])]])
        radiance = {panel.title: panel.image for panel in light}
        name = f"{run.scene}, {picture['name']}"
        illustrations.append(Illustration(name, caption, slug, figure, radiance))
    return illustrations


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
        verdicts, who = json.loads(same), ", ".join(runs)
        text += [f"{who}: {fault}" for fault in faults_of(verdicts)]
        rows = [[one["title"], STANDINGS[one["standing"]]] for one in verdicts.values()]
        if not rows:
            rows = [["no calibration", STANDINGS["unknown"]]]
            text.append(f"{who}: without a calibration; pictures may not be radiance.")
        table = Table("Verdicts", who, ["step", "verdict"], rows, 2, is_folded=False)
        blocks.append(table)
    return Section("calibration", "Calibration of the rig", blocks, text)
