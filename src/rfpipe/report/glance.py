"""What each run took and how good it is: one table, and a large picture of each scene."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.figure import Figure

from rfpipe.relighting import picture_errors
from rfpipe.report.drawing import ABREAST, UNLIT_GAIN, Panel, draw, draw_large, unlit_gain
from rfpipe.report.inputs import Inputs, Run, job_times, rig_of
from rfpipe.report.page import Column, Gallery, Illustration, Section, table_of
from rfpipe.report.text import ERROR, fixed, number, percent, rig_standing, words
from rfpipe.report.verification import summaries
from rfpipe.stages.evaluate import relative_rms
from rfpipe.transport.base import estimates

_SHOWN = "horizontal_bar"  # crosses the edge of two planes, where indirect light shows best


def glance_section(inputs: Inputs) -> Section:
    """Every run on one line, and a picture of each scene."""
    results = [result_of(inputs, run) for run in inputs.runs]
    kinds = {row["verified"] for row in results}
    columns: list[Column] = [
        ("patterns", "patterns", number),
        ("error, %", "mean_error", percent),
        ("verified by", "verified", str),
        ("its grain, %", "grain", percent),
        ("grain where unlit, %", "grain_unlit", percent),
        ("rig", "rig", str),
        ("largest error, %", "worst_error", percent),
        ("indirect light, %", "mean_indirect", percent),
        ("estimated error, %", "estimated_error", percent),
        ("time, min", "minutes", fixed(1)),
        ("stored, MB", "megabytes", fixed(2)),
    ]
    about = []
    if kinds != {_NOTHING}:
        about.append(f"{ERROR}, mean of shapes, bars and spots.")
    if any(row["mean_indirect"] is not None for row in results):
        about.append("Of indirect light: on pixels that a picture leaves dark.")
    if _RECORDED in kinds:
        about.append(
            "Recording: the truth is light transport that was traced by Monte Carlo, by which the "
            "rig is simulated, too; its grain is its own standard error, in a half-lit picture."
        )
    if _NOTHING in kinds:
        about.append("Not verified: the truth of a real scene is not known.")
    about.append(
        f"Time: capture, at {inputs.config.capture.seconds_per_pattern:g} s a pattern and without "
        "the reference brackets, and processing. 1 MB = 10⁶ bytes."
    )
    table = table_of(
        "What it took", " ".join(about), results, inputs.labels, columns, csv="results.csv",
        is_folded=False,
    )  # fmt: skip
    pictures = Gallery([scene_picture(inputs, inputs.of_scene(name)[0]) for name in inputs.scenes])
    text = _omissions(inputs)
    text += [sentence for run in inputs.runs if run.verified for sentence in summaries(inputs, run)]
    return Section("glance", "At a glance", [table, pictures], text)


def _omissions(inputs: Inputs) -> list[str]:
    """Return sentences on the light that scenes have and their simulation leaves out."""
    return [
        f"{scene}: {sentence}."
        for scene in inputs.scenes
        for sentence in inputs.light_of(scene).get("omissions", [])
    ]


_EXACT, _RECORDED, _NOTHING = "exact truth", "recording", "not verified"


def result_of(inputs: Inputs, run: Run) -> dict[str, Any]:
    """Return what a run cost and how far off its relit pictures are.

    Returns
    -------
    dict
        ``scene``, ``method``; ``rays``: patterns of brute force; ``patterns``;
        ``megabytes`` (10^6 bytes on disk); ``capture_s`` at the rig's stated seconds a pattern;
        ``processing_s``: wall seconds of all jobs but the capture's, NaN where they left none;
        ``minutes`` of capture and processing; ``verified``: by what, in words, and ``rig``: what it
        is or how good; ``mean_error``, ``mean_indirect``, ``worst_error`` as of `mean_errors` in
        `rfpipe.stages.relight`, or of pictures that no method saw where the truth isn't known;
        ``target_error`` and ``estimated_error`` of the method; ``grain``, ``grain_unlit`` of the
        truth, see `Scene.recorded`; None of what isn't known.
    """
    found = run.facts if run.has_truth else run.verified
    folder = inputs.results / run.scene / run.method
    capture = run.patterns * inputs.config.capture.seconds_per_pattern
    jobs = [*job_times(folder)]
    processing = sum(s for stage, s in jobs if stage != "capture") if jobs else math.nan
    recorded = run.facts.get("recorded", {}).get("grain", {})
    pictures = f"{len(run.verified['pictures'])} pictures" if run.verified else _NOTHING
    by_truth = _RECORDED if recorded else _EXACT
    *_, last = {}, *estimates(run.facts["levels"])
    return {
        "scene": run.scene,
        "method": run.method,
        "rays": run.rays,
        "patterns": run.patterns,
        "megabytes": run.facts["bytes"] / 1e6,
        "capture_s": capture,
        "processing_s": processing,
        "minutes": (capture + (0.0 if math.isnan(processing) else processing)) / 60,
        "verified": by_truth if run.has_truth else pictures,
        "rig": rig_standing(rig_of(inputs.results, run)),
        **{name: found.get(name) for name in ("mean_error", "mean_indirect", "worst_error")},
        "target_error": run.facts["options"].get("target_error"),
        "estimated_error": last.get("estimated_error"),
        "grain": recorded.get("whole"),
        "grain_unlit": recorded.get("unlit"),
    }


def scene_picture(inputs: Inputs, run: Run) -> Illustration:
    """Show a scene under floodlight and relit, beside truth or a picture that no method saw."""
    light, errors, said = _compared(run)
    images = {panel.title.replace(" ", "_"): panel.image for panel in light}
    figure: Figure
    if errors:
        figure = draw_large(light[:2], [light[2], *errors])
    else:
        figure = draw([light[at : at + ABREAST] for at in range(0, len(light), ABREAST)], 2.6)
    caption = (
        f"By {inputs.title(run.method).lower()}, {number(run.patterns)} patterns: {said}. White is "
        f"radiance {run.white:.3g}."
    )
    return Illustration(run.scene, caption, f"scene_{run.scene}", figure, images)


def _compared(run: Run) -> tuple[list[Panel], list[Any], str]:
    """Return a scene's pictures, floodlit first, the error of the second, and what is said of it.

    Without anything to compare with they are relit by all patterns, and there is no error.
    """
    floodlit = run.read("floodlit_truth" if run.has_truth else "floodlit_captured")
    light = [run.panel(run.middle(floodlit), "floodlit")]
    names = run.facts["names"]
    unseen = run.verified_images
    if not run.has_truth and unseen is None:
        images = run.middle(run.read("relit"))
        light += map(run.panel, images, map(words, names))
        error = relative_rms(run.read("floodlit_relit"), floodlit)
        return light, [], f"relit, the floodlit picture is {percent(error)} % off the captured one"
    gain: Any = 1.0
    if run.has_truth:
        index = names.index(_SHOWN) if _SHOWN in names else 0
        name, title = words(names[index]), "truth"
        image, truth, pattern = (run.read(it)[index] for it in ("relit", "truth", "patterns"))
        error = picture_errors(image[None], truth[None], pattern[None], floodlit)[0].item()
        said = f"error {percent(error)} % with the {name}"
        if run.is_coaxial and not run.settings.is_light_field:
            gain = unlit_gain(pattern)
            said += f"; unlit pixels are shown {UNLIT_GAIN} times brighter"
    elif unseen is not None:
        title, picture = "captured", run.verified["pictures"][0]
        image, truth = (unseen.read(it)[0] for it in ("relit", "captured"))
        said = f"error {percent(picture['error'])} % of a picture that no method saw"
    relit, true = (
        run.panel(run.middle(it), called, gain=gain)
        for it, called in ((image, "relit"), (truth, title))
    )
    return [*light, relit, true], [relit.less(true)], said
