"""Pictures of scenes, relit."""

from __future__ import annotations

from rfpipe.report.drawing import ABREAST, Panel, draw
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.page import Illustration, Section
from rfpipe.report.text import words
from rfpipe.stages.evaluate import relative_rms


def captured_section(inputs: Inputs) -> Section:
    """The scene under floodlight and under the relighting patterns, for each method."""
    caption = (
        "The scene under floodlight, as the rig captured it and as relit, with their relative RMS "
        "difference, and relit with each of the relighting patterns. The difference tells whether "
        "the levels add up, not whether each pixel's light comes from the right place."
    )
    return Section(
        "captured",
        "The scene relit",
        [
            Illustration(
                f"{run.scene}, {inputs.title(run.method).lower()}",
                caption,
                f"captured_{run.scene}_{run.method}",
                draw(captured_rows(run)),
            )
            for run in inputs.runs
        ],
    )


def captured_rows(run: Run) -> list[list[Panel]]:
    """Return the floodlit images and the relit ones, the middle view of several."""
    captured, relit = run.read("floodlit_captured"), run.read("floodlit_relit")
    difference = f"difference {relative_rms(relit, captured):.1%}"
    panels = [
        run.panel(run.middle(captured), "floodlit, captured", f"patterns {run.patterns:,}"),
        run.panel(run.middle(relit), "floodlit, relit", difference),
    ]
    images = run.middle(run.read("relit"))
    for name, image in zip(run.facts["names"], images, strict=True):
        panels.append(run.panel(image, words(name)))
    return [panels[first : first + ABREAST] for first in range(0, len(panels), ABREAST)]
