"""What each method took: scenes relit beside truth, patterns, bytes, errors, and seconds."""

from __future__ import annotations

import math
from typing import Any

from rfpipe.relighting import picture_errors
from rfpipe.report.drawing import UNLIT_GAIN, draw, unlit_gain
from rfpipe.report.inputs import Inputs, Run, job_times
from rfpipe.report.page import Column, Gallery, Illustration, Section, table_of
from rfpipe.report.text import ERROR, fixed, number, percent, words
from rfpipe.stages.evaluate import relative_rms

_SHOWN = "horizontal_bar"  # crosses the edge of two planes, where indirect light shows best


def glance_section(inputs: Inputs) -> Section:
    """A picture of each scene, and every run on one line."""
    columns: list[Column] = [
        ("patterns", "patterns", number),
        ("brute force", "rays", number),
        ("time, min", "minutes", fixed(1)),
        ("stored, MB", "megabytes", fixed(2)),
    ]
    lead = "Each scene under floodlight, and relit with a bar of light that nobody took."
    about = "The truth of a real scene is not known."
    if inputs.has_truth or any(run.verified for run in inputs.runs):
        truth = "the exact light transport" if inputs.has_truth else "pictures that no method saw"
        about = (
            f"{ERROR}: of relit shapes, bars and spots, against {truth}. Of indirect light: on "
            "pixels that a picture leaves dark."
        )
        columns += [
            ("mean error, %", "mean_error", percent),
            ("of indirect light, %", "mean_indirect", percent),
            ("largest error, %", "worst_error", percent),
        ]
    seconds = f"{inputs.config.capture.seconds_per_pattern:g} s a pattern"
    caption = (
        f"Minutes of capture, at {seconds} and without the reference brackets, and of processing; "
        f"1 MB = 10⁶ bytes. {about}"
    )
    table = table_of(
        "What it took", caption, [result_of(inputs, run) for run in inputs.runs], inputs.labels,
        columns, csv="results.csv", is_folded=False,
    )  # fmt: skip
    pictures = Gallery([scene_picture(inputs, inputs.of_scene(name)[0]) for name in inputs.scenes])
    return Section("glance", "At a glance", [pictures, table], [lead])


def result_of(inputs: Inputs, run: Run) -> dict[str, Any]:
    """Return what a run cost and how far off its relit pictures are.

    Returns
    -------
    dict
        ``scene``, ``method``; ``rays``: patterns of brute force; ``patterns``;
        ``megabytes`` (10^6 bytes on disk); ``capture_s`` at the rig's stated seconds a pattern;
        ``processing_s``: wall seconds of all jobs but the capture's, NaN where they left none;
        ``minutes`` of capture and processing; ``mean_error``, ``mean_indirect``, ``worst_error``
        as of `mean_errors` in `rfpipe.stages.relight`, or of pictures that no method saw where the
        truth isn't known; None of what isn't either.
    """
    found = run.facts if run.has_truth else run.verified
    jobs = [*job_times(inputs.results / run.scene / run.method)]
    capture = run.patterns * inputs.config.capture.seconds_per_pattern
    processing = sum(s for stage, s in jobs if stage != "capture") if jobs else math.nan
    return {
        "scene": run.scene,
        "method": run.method,
        "rays": run.rays,
        "patterns": run.patterns,
        "megabytes": run.facts["bytes"] / 1e6,
        "capture_s": capture,
        "processing_s": processing,
        "minutes": (capture + (0.0 if math.isnan(processing) else processing)) / 60,
        **{name: found.get(name) for name in ("mean_error", "mean_indirect", "worst_error")},
    }


def scene_picture(inputs: Inputs, run: Run) -> Illustration:
    """Show a scene under floodlight and relit, beside the truth where that is known."""
    names = run.facts["names"]
    index = names.index(_SHOWN) if _SHOWN in names else 0
    pattern, image = run.read("patterns")[index], run.read("relit")[index]
    floodlit = run.read("floodlit_truth" if run.has_truth else "floodlit_captured")
    is_brightened = run.has_truth and run.is_coaxial and not run.settings.is_light_field
    gain = unlit_gain(pattern) if is_brightened else 1.0
    relit = run.panel(run.middle(image), "relit", gain=gain)
    light = [run.panel(run.middle(floodlit), "floodlit"), relit]
    errors = []
    if run.has_truth:
        truth = run.read("truth")[index]
        light.append(run.panel(run.middle(truth), "truth", gain=gain))
        errors = [relit.less(light[-1])]
        error = picture_errors(image[None], truth[None], pattern[None], floodlit)[0].item()
        accuracy = f"error {percent(error)} %"
    else:
        error = relative_rms(run.read("floodlit_relit"), floodlit)
        accuracy = f"floodlit image relit to {percent(error)} % of the captured one"
    caption = (
        f"{inputs.title(run.method)}, {number(run.patterns)} patterns: {accuracy} with the "
        f"{words(names[index])}; white is radiance {run.white:.3g}."
    )
    if is_brightened:
        caption += f" Unlit pixels are shown {UNLIT_GAIN} times brighter."
    images = {panel.title: panel.image for panel in light}
    return Illustration(run.scene, caption, f"scene_{run.scene}", draw([[*light, *errors]]), images)
