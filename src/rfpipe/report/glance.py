"""What each method took: scenes relit beside truth, patterns, bytes, errors, and seconds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rfpipe.report.drawing import UNLIT_GAIN, draw, unlit_gain
from rfpipe.report.inputs import Inputs, Run, job_times
from rfpipe.report.page import Column, Gallery, Illustration, Section, table_of
from rfpipe.report.text import fixed, number, percent, words
from rfpipe.stages.evaluate import relative_rms

if TYPE_CHECKING:
    import pandas as pd

_SHOWN = "horizontal_bar"  # crosses the edge of two planes, where indirect light shows best


def glance_section(inputs: Inputs) -> Section:
    """A picture of each scene, and every run on one line."""
    numbers = results(inputs)
    columns: list[Column] = [
        ("patterns", "patterns", number),
        ("brute force", "rays", number),
        ("time, min", "minutes", fixed(1)),
        ("stored, MB", "megabytes", fixed(2)),
    ]
    lead = "Each scene under floodlight, and relit with a bar of light that nobody took."
    if inputs.has_truth:
        about = (
            "Error: relative RMS of pictures relit with bars, noise, a binary picture, a small "
            "spot and the crease where surfaces meet, against the exact light transport."
        )
        columns += [
            ("mean error, %", "mean_error", percent),
            ("largest error, %", "worst_error", percent),
            ("mean on unlit pixels, %", "unlit_error", percent),
        ]
    else:
        about = "The truth of a real scene is not known."
        if any(run.verified for run in inputs.runs):
            about += " Error: of pictures that no method saw, without their noise."
            columns += [
                ("mean error, %", "verified_error", percent),
                ("largest error, %", "verified_worst_error", percent),
            ]
    seconds = f"{inputs.config.capture.seconds_per_pattern:g} s a pattern"
    caption = (
        f"Minutes of capture, at {seconds} and without the reference brackets, and of processing; "
        f"1 MB = 10⁶ bytes. {about}"
    )
    table = table_of(
        "What it took", caption, numbers, inputs.labels, columns, csv="results.csv", is_folded=False
    )
    pictures = Gallery([scene_picture(inputs, inputs.of_scene(name)[0]) for name in inputs.scenes])
    return Section("glance", "At a glance", [pictures, table], [lead])


def results(inputs: Inputs) -> pd.DataFrame:
    """Return what each run cost and how far off its relit pictures are.

    Returns
    -------
    DataFrame
        For each run ``scene``, ``method``; ``rays``: patterns of brute force; ``patterns``;
        ``megabytes`` (10^6 bytes on disk); ``capture_s`` at the rig's stated seconds a pattern;
        ``processing_s``: wall seconds of all jobs but the capture's, NaN where they left none;
        ``minutes`` of capture and processing;
        ``verified_error``, ``verified_worst_error``: of pictures that no method saw. Over the
        relighting patterns ``mean_error`` and ``worst_error`` in total, ``unlit_error``: the mean
        on the unlit pixels, ``psnr_db``: the least, ``ciede2000``: the largest; NaN where the
        truth isn't known.
    """
    import pandas as pd

    errors = inputs.errors.groupby(["scene", "method"], sort=False).agg(
        mean_error=("rms_total", "mean"),
        worst_error=("rms_total", "max"),
        unlit_error=("rms_unlit", "mean"),
        psnr_db=("psnr_db", "min"),
        ciede2000=("ciede2000", "max"),
    )
    costs = pd.DataFrame([_cost(inputs, run) for run in inputs.runs])
    return costs.merge(errors, how="left", on=["scene", "method"])


def _cost(inputs: Inputs, run: Run) -> dict[str, Any]:
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
        "verified_error": run.verified.get("mean_error"),
        "verified_worst_error": run.verified.get("worst_error"),
        "processing_s": processing,
        "minutes": (capture + (0.0 if math.isnan(processing) else processing)) / 60,
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
        accuracy = f"error {percent(relative_rms(image, truth))} %"
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
