"""What each run took and how good it is: one table, and pictures of each scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rfpipe.report.inputs import Inputs, Run, pictures_of, rig_of, seconds_spent
from rfpipe.report.page import Block, Column, Gallery, Section, Table, table_of
from rfpipe.report.pictures import scene_pictures
from rfpipe.report.targets import ending_of, missed_targets
from rfpipe.report.text import ERROR, fixed, indirect_percent, number, percent, rig_standing
from rfpipe.report.verification import alarms_of, summary
from rfpipe.transport.base import last_estimate

_EXACT, _RECORDED, _NOTHING = "exact truth", "recording", "not verified"
_SIMULATED = "simulated"

_NUMBERS: tuple[Column, ...] = (
    ("patterns", "patterns", number),
    ("pictures on the rig", "pictures", number),
    ("error, %", "mean_error", percent),
    ("largest error, %", "worst_error", percent),
    ("error of indirect light, %", "mean_indirect", indirect_percent),
    ("estimated error, %", "estimated_error", percent),
)
_TIME: Column = ("time, min", "minutes", fixed(1))


def glance_section(inputs: Inputs) -> Section:
    """Every run on one line, what missed its target, and pictures of each scene."""
    results = [result_of(inputs, run) for run in inputs.runs]
    missed = [
        [*missed_targets(row, ending_of(run.facts["levels"]), by_few_pictures=not run.has_truth)]
        for row, run in zip(results, inputs.runs, strict=True)
    ]
    noticed = [
        [*sentences, *alarms_of(inputs, run)]
        for sentences, run in zip(missed, inputs.runs, strict=True)
    ]
    alarms = [
        f"{run.scene}, {inputs.title(run.method).lower()}: {sentence}"
        for run, sentences in zip(inputs.runs, noticed, strict=True)
        for sentence in sentences
    ]
    alarmed = frozenset(index for index, sentences in enumerate(noticed) if sentences)
    shown = [
        {**row, "target": f"{percent(row['target_error'])}{' MISSED' if sentences else ''}"}
        for row, sentences in zip(results, missed, strict=True)
    ]
    tables = _main_table(inputs, results, shown, alarmed), seeds_table(inputs, results)
    blocks: list[Block] = [table for table in tables if table is not None]
    blocks.append(Gallery([scene_pictures(inputs, group) for group in inputs.seed_groups]))
    text = _omissions(inputs)
    text += [summary(inputs, run) for run in inputs.runs if run.verified]
    return Section("glance", "At a glance", blocks, text, alarms)


def _main_table(
    inputs: Inputs,
    results: Sequence[Mapping[str, Any]],
    shown: Sequence[Mapping[str, Any]],
    alarmed: frozenset[int],
) -> Table:
    """Return the table of all runs; what is the same of all simulated ones stands in its caption.

    `shown` are the results with their ``target`` as text, `alarmed` the rows in red.
    """
    import pandas as pd

    verified = {row["verified"] for row in results} != {_EXACT}
    on_rigs = {row["rig"] for row in results} != {_SIMULATED}
    columns: list[Column] = [
        *_NUMBERS,
        ("target, %", "target", str),
        *([("verified by", "verified", str)] if verified else []),
        *([("rig", "rig", str)] if on_rigs else []),
        _TIME,
        ("stored, MB", "megabytes", fixed(2)),
    ]
    return table_of(
        "What it took", _about(inputs, results), shown, inputs.labels, columns,
        csv="results.csv", numbers=pd.DataFrame(results), is_folded=False, has_latex=True,
        alarmed=alarmed,
    )  # fmt: skip


def _omissions(inputs: Inputs) -> list[str]:
    """Return sentences on the light that scenes have and their simulation leaves out."""
    return [
        f"{scene}: {sentence}."
        for scene in inputs.scenes
        for sentence in inputs.light_of(scene).get("omissions", [])
    ]


def _about(inputs: Inputs, results: Sequence[Mapping[str, Any]]) -> str:
    """Return the caption of the main table."""
    kinds = {row["verified"] for row in results}
    pictures = (
        "Pictures on the rig: of the patterns, black and white references, patterns that test "
        "symmetry, and looks at the rig; those that verify are not counted."
    )
    about = [pictures]
    if kinds != {_NOTHING}:
        about.append(f"{ERROR}, mean of shapes, bars and spots.")
    if kinds == {_EXACT}:
        about.append("Errors are against the exact truth.")
    if any(row["mean_indirect"] is not None for row in results):
        about.append(
            "Error of indirect light: on pixels that a picture leaves dark, relative to the light "
            "there; it is no share of the light."
        )
    if _RECORDED in kinds:
        grains = dict.fromkeys(
            f"{row['scene']} {percent(row['grain'])} % ({percent(row['grain_unlit'])} % on unlit "
            "pixels)"
            for row in results
            if row["grain"] is not None
        )
        about.append(
            "Recording: the truth is light transport that was traced by Monte Carlo, by which the "
            "rig is simulated, too; its grain is its standard error, in a half-lit picture: "
            f"{', '.join(grains)}."
        )
    if _NOTHING in kinds:
        about.append("Not verified: the truth of a real scene is not known.")
    about.append(
        f"Time: capture of the pictures on the rig, at "
        f"{inputs.config.capture.seconds_per_pattern:g} s each, and processing. 1 MB = 10⁶ bytes."
    )
    return " ".join(about)


def result_of(inputs: Inputs, run: Run) -> dict[str, Any]:
    """Return what a run cost and how far off its relit pictures are.

    Returns
    -------
    dict
        ``scene``, ``method``; ``rays``: patterns of brute force; ``patterns``; ``pictures`` that
        the rig took, see `rfpipe.report.inputs.pictures_of`; ``megabytes`` (10^6 bytes on disk);
        ``capture_s`` of these pictures at the rig's stated seconds each, and ``processing_s``: wall
        seconds of all jobs except captures, see `rfpipe.report.inputs.seconds_spent`; ``minutes``
        of capture and processing;
        ``verified``: by what, in words, and ``rig``: what it is or how good; ``mean_error``,
        ``mean_indirect`` (the error of indirect light), ``worst_error`` as of `mean_errors` in
        `rfpipe.stages.relight`, or of pictures that no method saw where the truth isn't known;
        ``target_error``, ``target_indirect``, ``estimated_error`` and ``estimated_indirect`` of the
        method; ``grain``, ``grain_unlit`` of the truth, see `Scene.recorded`; None of what isn't
        known.
    """
    errors = run.facts if run.has_truth else run.verified
    folder = inputs.results / run.scene / run.method
    spent = seconds_spent(folder, inputs.config.capture.seconds_per_pattern)
    recorded = run.facts.get("recorded", {}).get("grain", {})
    pictures = f"{len(run.verified['pictures'])} pictures" if run.verified else _NOTHING
    by_truth = _RECORDED if recorded else _EXACT
    last = last_estimate(run.facts["levels"])
    options = run.facts["options"]
    return {
        "scene": run.scene,
        "method": run.method,
        "rays": run.rays,
        "patterns": run.patterns,
        "pictures": pictures_of(folder),
        "megabytes": run.facts["bytes"] / 1e6,
        "capture_s": spent.capture,
        "processing_s": spent.processing,
        "minutes": spent.total / 60,
        "verified": by_truth if run.has_truth else pictures,
        "rig": rig_standing(rig_of(inputs.results, run)),
        **{name: errors.get(name) for name in ("mean_error", "mean_indirect", "worst_error")},
        **{name: options.get(name) for name in ("target_error", "target_indirect")},
        **{name: _known(last.get(name)) for name in ("estimated_error", "estimated_indirect")},
        "grain": recorded.get("whole"),
        "grain_unlit": recorded.get("unlit"),
    }


def _known(value: float | None) -> float | None:
    """Return a number, None for NaN."""
    return None if value is None or math.isnan(value) else value


def seeds_table(inputs: Inputs, results: Sequence[Mapping[str, Any]]) -> Table | None:
    """Return the means and standard deviations over scenes that differ by their seeds alone."""
    import pandas as pd

    every, rows = pd.DataFrame(results), []
    for group in inputs.seed_groups:
        if len(group.scenes) < 2:
            continue
        of_group = every[every["scene"].isin(group.scenes)]
        for method, of_method in of_group.groupby("method", sort=False):
            row: dict[str, Any] = {"scene": group.name, "method": method, "seeds": len(of_method)}
            for _, name, _ in (*_NUMBERS, _TIME):
                values: pd.Series[Any] = of_method[str(name)].astype("float64")
                row |= {name: values.mean(), f"{name}_sd": values.std()}
            rows.append(row)
    if not rows:
        return None
    columns: list[Column] = [("seeds", "seeds", number)]
    shown = [dict(row) for row in rows]
    for heading, name, text in (*_NUMBERS, _TIME):
        columns.append((heading, f"{name}_text", str))
        for row in shown:
            row[f"{name}_text"] = _with_deviation(row[name], row[f"{name}_sd"], text)
    about = "Mean ± standard deviation over scenes that differ by their seeds alone."
    return table_of(
        "Over seeds", about, shown, inputs.labels, columns,
        csv="seeds.csv", numbers=pd.DataFrame(rows), is_folded=False, has_latex=True,
    )  # fmt: skip


def _with_deviation(mean: float, deviation: float, text: Callable[[Any], str]) -> str:
    """Return a mean and its standard deviation, to as many digits, as text; a word for none."""
    shown = text(mean)
    if not any(map(str.isdigit, shown)):
        return shown
    if "e" in shown:
        return f"{shown} ± {text(deviation)}"
    digits = len(shown.partition(".")[2])
    scale = 100 if text in (percent, indirect_percent) else 1
    return f"{shown} ± {number(deviation, f',.{digits}f', scale)}"
