"""Cost and error of each acquisition in one table, and pictures of each scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rfpipe.report.inputs import RelitAcquisition, ReportInputs, rig_of, seconds_spent
from rfpipe.report.page import Block, Column, Gallery, Section, Table, table_of
from rfpipe.report.pictures import scene_pictures
from rfpipe.report.targets import ending_of, missed_target_texts
from rfpipe.report.text import ERROR, fixed, indirect_percent, number, rig_standing, rounded_percent
from rfpipe.report.verification import alarms_of, summary
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.transport.base import last_estimate

_EXACT, _RECORDED, _NOTHING = "exact truth", "recording", "not verified"
_SIMULATED = "simulated"

_NUMBERS: tuple[Column, ...] = (
    ("patterns", "patterns", number),
    ("pictures on the rig", "pictures", number),
    ("error, %", "mean_error", rounded_percent),
    ("largest error, %", "worst_error", rounded_percent),
    ("error of indirect light, %", "mean_indirect", indirect_percent),
    ("estimated error, %", "estimated_error", rounded_percent),
)
_TIME: Column = ("time, min", "minutes", fixed(1))

_PURPOSES: tuple[Column, ...] = (
    ("references", "reference_pictures", number),
    ("symmetry test", "symmetry_pictures", number),
    ("patterns", "patterns", number),
    ("check pictures", "check_pictures", number),
    ("verification", "verification_pictures", number),
    ("pictures on the rig", "pictures", number),
    ("exposures", "frames", number),
    ("minutes on the rig", "capture_minutes", fixed(1)),
)


def glance_section(inputs: ReportInputs) -> Section:
    """Return the section with a table of all acquisitions, missed targets, and pictures."""
    results = [result_of(inputs, run) for run in inputs.runs]
    missed = [
        [
            *missed_target_texts(
                row, ending_of(run.facts["levels"]), by_few_pictures=not run.has_truth
            )
        ]
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
        {**row, "target": f"{rounded_percent(row['target_error'])}{' MISSED' if sentences else ''}"}
        for row, sentences in zip(results, missed, strict=True)
    ]
    tables = _main_table(inputs, results, shown, alarmed), seeds_table(inputs, results)
    blocks: list[Block] = [table for table in tables if table is not None]
    blocks.append(Gallery([scene_pictures(inputs, group) for group in inputs.seed_groups]))
    purposes = _pictures_table(inputs, results)
    blocks += [] if purposes is None else [purposes]
    text = _omissions(inputs)
    text += [summary(inputs, run) for run in inputs.runs if run.verified]
    return Section("glance", "At a glance", blocks, text, alarms)


def _main_table(
    inputs: ReportInputs,
    results: Sequence[Mapping[str, Any]],
    shown: Sequence[Mapping[str, Any]],
    alarmed: frozenset[int],
) -> Table:
    """Return the table of all acquisitions.

    `shown` are the results with their ``target`` as text, `alarmed` the indices of red rows.
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
        "Cost and error", _caption(inputs, results), shown, inputs.labels, columns,
        csv="results.csv", numbers=pd.DataFrame(results), is_folded=False, has_latex=True,
        alarmed=alarmed,
    )  # fmt: skip


def _pictures_table(inputs: ReportInputs, results: Sequence[Mapping[str, Any]]) -> Table | None:
    """Return the table of the pictures on the rig by purpose; None where no capture is known."""
    known = [row for row in results if row["pictures"]]
    if not known:
        return None
    seconds = inputs.config.capture.seconds_per_pattern
    caption = (
        "Brackets that the rig took, by their purpose, and their exposures. Minutes on the rig: "
        f"{seconds:g} s for each picture. Patterns are those of the method, as the thesis counts "
        "them. Numbers: tables/results.csv."
    )
    shown = [{**row, "capture_minutes": row["capture_s"] / 60} for row in known]
    return table_of("Pictures on the rig", caption, shown, inputs.labels, _PURPOSES)


def _omissions(inputs: ReportInputs) -> list[str]:
    """Return sentences on the light that the simulation of a scene omits."""
    return [
        f"{scene}: {sentence}."
        for scene in inputs.scenes
        for sentence in inputs.light_of(scene).get("omissions", [])
    ]


def _caption(inputs: ReportInputs, results: Sequence[Mapping[str, Any]]) -> str:
    """Return the caption of the main table."""
    kinds = {row["verified"] for row in results}
    pictures = (
        "Pictures on the rig: brackets for all purposes, which are patterns, references, random "
        "patterns of the symmetry test, check pictures and verification pictures."
    )
    sentences = [pictures]
    if kinds != {_NOTHING}:
        sentences.append(f"{ERROR}; mean over shapes, bars and spots.")
    if kinds == {_EXACT}:
        sentences.append("Errors are relative to the exact truth.")
    if any(row["mean_indirect"] is not None for row in results):
        sentences.append(
            "Error of indirect light: on pixels that a pattern leaves dark, relative to the light "
            "there."
        )
    if _RECORDED in kinds:
        grains = dict.fromkeys(
            f"{row['scene']} {rounded_percent(row['grain'])} % "
            f"({rounded_percent(row['grain_unlit'])} % on unlit pixels)"
            for row in results
            if row["grain"] is not None
        )
        sentences.append(
            "Recording: the truth is light transport traced by Monte Carlo, by which the rig is "
            "simulated, too. Its standard error in a half-lit picture: "
            f"{', '.join(grains)}."
        )
    if _NOTHING in kinds:
        sentences.append("Not verified: the true light transport of a real scene is unknown.")
    sentences.append(
        "Time: capture of the pictures on the rig, at "
        f"{inputs.config.capture.seconds_per_pattern:g} s each, and processing. 1 MB = 10⁶ bytes."
    )
    return " ".join(sentences)


def result_of(inputs: ReportInputs, run: RelitAcquisition) -> dict[str, Any]:
    """Return the cost of an acquisition and the errors of its relit pictures.

    Returns
    -------
    dict
        Values that are unknown are None.

        ``scene``, ``method``; ``rays``, the number of patterns of brute force; ``patterns``;
        ``pictures`` on the rig for all purposes, ``reference_pictures``, ``symmetry_pictures``,
        ``check_pictures`` and ``verification_pictures`` among them, and their ``frames``, see
        `rfpipe.storage.picture_counts`; ``megabytes`` of the transport, 10^6 bytes on disk.

        ``capture_s``: time of these pictures; ``processing_s``: wall time of all jobs except
        captures, see `rfpipe.report.inputs.seconds_spent`; ``minutes``: their sum.

        ``mean_error``, ``worst_error`` and ``mean_indirect`` (error of indirect light): against the
        truth, see `rfpipe.stages.relight.mean_errors`, or else in the verification pictures.
        ``verified``: kind of that truth, in words. ``rig``: kind or calibration of the rig.
        ``target_error``, ``target_indirect``, ``estimated_error``, ``estimated_indirect``: of the
        method. ``grain``, ``grain_unlit``: of the truth, see `Scene.recorded`.
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
        **_picture_numbers(folder),
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


def _picture_numbers(folder: Path) -> dict[str, int | None]:
    """Return the numbers of pictures on the rig and of frames; None without captures."""
    counts = captured_pictures(FolderStorage(folder))
    numbers = {
        "pictures": counts.total,
        "reference_pictures": counts.references,
        "symmetry_pictures": counts.symmetry,
        "check_pictures": counts.checks,
        "verification_pictures": counts.verification,
        "frames": counts.frames,
    }
    return {name: value if counts.total else None for name, value in numbers.items()}


def _known(value: float | None) -> float | None:
    """Return a number, None for NaN."""
    return None if value is None or math.isnan(value) else value


def seeds_table(inputs: ReportInputs, results: Sequence[Mapping[str, Any]]) -> Table | None:
    """Return the means and standard deviations over scenes that differ only in their seeds."""
    import pandas as pd

    table, rows = pd.DataFrame(results), []
    for group in inputs.seed_groups:
        if len(group.scenes) < 2:
            continue
        group_rows = table[table["scene"].isin(group.scenes)]
        for method, method_rows in group_rows.groupby("method", sort=False):
            row: dict[str, Any] = {"scene": group.name, "method": method, "seeds": len(method_rows)}
            for _, name, _ in (*_NUMBERS, _TIME):
                values: pd.Series[Any] = method_rows[str(name)].astype("float64")
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
    caption = "Mean ± standard deviation over scenes that differ only in their seeds."
    return table_of(
        "Over seeds", caption, shown, inputs.labels, columns,
        csv="seeds.csv", numbers=pd.DataFrame(rows), is_folded=False, has_latex=True,
    )  # fmt: skip


def _with_deviation(mean: float, deviation: float, text: Callable[[Any], str]) -> str:
    """Return a mean and its standard deviation as text, with the same number of decimals."""
    shown = text(mean)
    if not any(map(str.isdigit, shown)):
        return shown
    if "e" in shown:
        return f"{shown} ± {text(deviation)}"
    digits = len(shown.partition(".")[2])
    scale = 100 if text in (rounded_percent, indirect_percent) else 1
    return f"{shown} ± {number(deviation, f',.{digits}f', scale)}"
