"""What the report begins with: each scene relit beside truth, and what each method took for it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rfpipe.report import methods
from rfpipe.report.blocks import Column, Gallery, Picture, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import UNLIT_GAIN, unlit_gain
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import fixed, number, percent, words
from rfpipe.stages.evaluating.metrics import relative_rms

if TYPE_CHECKING:
    import pandas as pd

_SHOWN = "horizontal_bar"  # crosses the edge of two planes, where indirect light shows best


def glance_section(inputs: Inputs) -> Section:
    """A picture of each scene, and every run on one line."""
    numbers = results(inputs)
    pictures = [scene_picture(inputs.of_scene(scene)[0]) for scene in inputs.scenes]
    if inputs.has_truth:
        about = (
            "Error: relative RMS of the pictures relit with bars, noise, a binary picture, a small "
            "spot and the crease where surfaces meet, against the scene's exact light transport; "
            "their mean, the largest, and the mean on those pixels alone that the pattern leaves "
            "dark, which show indirect light."
        )
    else:
        about = "The truth of a real scene is not known."
        if any(run.verified for run in inputs.runs):
            about += (
                " Error: of pictures that no method saw, captured and relit, without their noise; "
                "their mean, and the largest."
            )
    per_pattern = inputs.config.capture.seconds_per_pattern
    caption = (
        f"Patterns shown; minutes of capture, at {per_pattern:g} s a pattern, and processing"
        f"{inputs.without_references}; bytes on disk, 1 MB = 10⁶ bytes. {about}"
    )
    table = _table(inputs, numbers)
    return Section(
        "glance",
        "At a glance",
        [Gallery(pictures), Tabulation("What it took", caption, table, is_folded=False)],
        [_scenes_text(inputs), _found(numbers)],
    )


def _scenes_text(inputs: Inputs) -> str:
    """Say what the pictures show."""
    text = (
        "Each scene under floodlight, and relit from what was acquired with a bar of light, a "
        "picture that nobody took"
    )
    if not inputs.has_truth:
        return f"{text}."
    text += ", beside the truth"
    return text + ", and the difference."


def _found(numbers: pd.DataFrame) -> str:
    """Sum each method up in a sentence."""
    sentences = []
    for method, own in numbers.groupby("method", sort=False):
        sentence = f"{methods.title(str(method))}: {_range(own['patterns'], number)} patterns"
        if own["mean_error"].notna().any():
            error = _range(own["mean_error"], percent)
            sentence += f" for a mean error of {error}\N{NO-BREAK SPACE}%"
        sentences.append(sentence)
    rays = _range(numbers["rays"], number)
    sentences.append(f"Brute force, one pattern a projector pixel, would take {rays}.")
    return ". ".join(sentences)


def _range(values: Any, shown: Any) -> str:
    """Return the least and the largest of some numbers; one of them where they look the same."""
    low, high = shown(values.min()), shown(values.max())
    return low if low == high else f"{low} to {high}"


def results(inputs: Inputs) -> pd.DataFrame:
    """Return what each run cost and how far off its relit pictures are.

    Returns
    -------
    DataFrame
        For each run ``scene``, ``method``, ``views``, ``height``, ``width``, ``channels``;
        ``rays``: patterns of brute force; ``patterns``; ``megabytes`` (10^6 bytes on disk) and
        ``dense_terabytes`` of T as float32; ``capture_s`` at the rig's stated seconds a pattern,
        ``capture_jobs_s`` and ``processing_s``: wall seconds of the capture's and of all other
        jobs, NaN where they left none; ``minutes`` of capture and processing;
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
    settings, jobs = run.settings, run.own(inputs.times)
    capture = run.patterns * inputs.config.capture.seconds_per_pattern
    is_capture = jobs["stage"] == "capture"
    processing = jobs["seconds"][~is_capture].sum(min_count=1)
    entries = run.rays * math.prod(settings.camera_ray_shape) * settings.channels
    return {
        "scene": run.scene,
        "method": run.method,
        "views": math.prod(settings.view_grid),
        "height": settings.shape[0],
        "width": settings.shape[1],
        "channels": settings.channels,
        "rays": run.rays,
        "patterns": run.patterns,
        "megabytes": run.facts["bytes"] / 1e6,
        "dense_terabytes": 4 * entries / 1e12,
        "capture_s": capture,
        "capture_jobs_s": jobs["seconds"][is_capture].sum(min_count=1),
        "verified_error": run.verified.get("mean_error"),
        "verified_worst_error": run.verified.get("worst_error"),
        "processing_s": processing,
        "minutes": (capture + (0.0 if math.isnan(processing) else processing)) / 60,
    }


def _table(inputs: Inputs, found: pd.DataFrame) -> Table:
    """Return patterns, minutes, bytes and errors of each run, as `results` found, on one line."""
    columns: list[Column] = [
        ("patterns", "patterns", number),
        ("brute force", "rays", number),
        ("time, min", "minutes", fixed(1)),
        ("stored, MB", "megabytes", fixed(2)),
        ("mean", "mean_error", percent),
        ("largest", "worst_error", percent),
        ("mean on unlit pixels", "unlit_error", percent),
    ]
    groups = [("", 2), ("cost", 4), ("error of relit pictures, %", 3)]
    if not inputs.has_truth:
        columns, groups = columns[:4], []
        if any(run.verified for run in inputs.runs):
            groups = [("", 2), ("cost", 4), ("error of pictures that no method saw, %", 2)]
            columns += [
                ("mean", "verified_error", percent),
                ("largest", "verified_worst_error", percent),
            ]
    return table_of(found, inputs.labels, columns, groups, csv="results.csv")


def scene_picture(run: Run) -> Picture:
    """Show a scene under floodlight and relit, beside the truth where that is known."""
    names = run.facts["names"]
    index = names.index(_SHOWN) if _SHOWN in names else 0
    pattern, relit = run.read("patterns")[index], run.read_shown("relit")[index]
    floodlit = run.read_shown("floodlit_truth" if run.has_truth else "floodlit_captured")
    is_brightened = run.has_truth and run.is_coaxial and not run.settings.is_light_field
    gain = unlit_gain(pattern) if is_brightened else 1.0
    light = [run.light("floodlit", floodlit), run.light("relit", relit, gain)]
    if run.has_truth:
        light.append(run.light("truth", run.read_shown("truth")[index], gain))
        error = relative_rms(run.read("relit")[index], run.read("truth")[index])
        said = f"error {percent(error)} %"
    else:
        error = relative_rms(run.read("floodlit_relit"), run.read("floodlit_captured"))
        said = f"floodlit image relit to {percent(error)} % of the captured one"
    caption = (
        f"{run.method_title}, {number(run.patterns)} patterns: {said} with the "
        f"{words(names[index])}."
    )
    if is_brightened:
        caption += f" Its unlit pixels are shown {UNLIT_GAIN:g} times brighter."
    compared = (1, 2) if run.has_truth else None
    return Picture(run.title, caption, f"scene_{run.scene}", light, compared)
