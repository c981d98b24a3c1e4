"""Errors: by relighting pattern, against the patterns shown, and as methods estimated them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rfpipe.report.drawing import scene_curves
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.page import Illustration, Section, table_of
from rfpipe.report.text import ERROR, fixed, number, percent, words
from rfpipe.transport.base import HISTORY_COLUMNS, estimates

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "#5c5c5c"


def errors_section(inputs: Inputs) -> Section:
    """The errors of each run by kinds of pictures, and under each relighting pattern."""
    about = (
        f"{ERROR}, against the scene's exact light transport; means of shapes, bars and spots, and "
        "single patterns. Indirect: on pixels that a pattern leaves dark, of the light there. "
        "Noise leaves none dark; no pixel is known to be unlit that a camera sees from aside; "
        "those of a light field may get light from other views."
    )
    summary = table_of(
        "Errors by pattern",
        about,
        inputs.errors,
        [*inputs.labels, ("pattern", "pattern", words)],
        [
            ("error, %", "error", percent),
            ("indirect, %", "indirect_error", percent),
            ("CIEDE2000", "ciede2000", fixed(2)),
        ],
        csv="errors.csv",
        numbers=None,
    )
    return Section("errors", "Errors by pattern", [summary])


def speed_section(inputs: Inputs) -> Section | None:
    """Error against patterns, level by level, true and as methods estimated it."""
    table, steps = inputs.speed_error, histories(inputs.runs)
    names = {*table["scene"], *steps["scene"]}
    if not names:
        return None
    scenes = [scene for scene in inputs.scenes if scene in names]
    caption = (
        "Mean error of relit pictures, as if the acquisition had stopped after each level, against "
        "the patterns shown by then. Methods that fit all their pictures together have their last "
        "level alone. Dotted: the mean error that a method itself estimated while it ran. Numbers: "
        "tables/speed_error.csv."
    )
    figure = speed_figure(inputs, scenes, table, steps)
    name = "Speed against error"
    return Section("speed", name, [Illustration(name, caption, "speed_error", figure)])


def speed_figure(
    inputs: Inputs, scenes: Sequence[str], table: pd.DataFrame, steps: pd.DataFrame
) -> Figure:
    """Draw true errors of the speed table, and the estimates of `histories`."""

    def draw_scene(axis: Axes, scene: str) -> None:
        for method, rows in table[table["scene"] == scene].groupby("method", sort=False):
            axis.plot(rows["patterns"], 100 * rows["error"], **inputs.style(str(method)))
        for method, rows in steps[steps["scene"] == scene].groupby("method", sort=False):
            estimated = {**inputs.style(str(method)), "linestyle": ":"}
            axis.plot(rows["patterns"], 100 * rows["estimated_error"], **estimated)
        brute: dict[str, Any] = {"color": _GREY, "linewidth": 0.9, "linestyle": ":"}
        rays = inputs.of_scene(scene)[0].rays
        axis.axvline(rays, label="patterns of brute force", **brute)

    return scene_curves(scenes, draw_scene)


def estimates_section(inputs: Inputs) -> Section | None:
    """Last estimates beside true errors, or None where no method estimated its own."""
    compared = compare(inputs)
    if not compared:
        return None
    table = table_of(
        "Estimated and true error",
        "A method's last estimate of the mean error of relit pictures, without the camera's noise; "
        "where the truth is known, that error, of their indirect light, and the ratio.",
        compared,
        inputs.labels,
        [
            ("patterns", "patterns", number),
            ("asked for, %", "target_error", percent),
            ("estimated, %", "estimated_error", percent),
            ("true, %", "true_error", percent),
            ("true of indirect light, %", "true_indirect", percent),
            ("estimated over true", "ratio", fixed(2)),
        ],
        csv="estimates.csv",
    )
    return Section("estimates", "Estimated error while it ran", [table])


def histories(runs: Sequence[Run]) -> pd.DataFrame:
    """Return the estimates of all runs: ``scene``, ``method`` and `HISTORY_COLUMNS`."""
    import pandas as pd

    rows = [
        {"scene": run.scene, "method": run.method, **step}
        for run in runs
        for step in estimates(run.facts["levels"])
    ]
    return pd.DataFrame(rows, columns=["scene", "method", *HISTORY_COLUMNS])


def compare(inputs: Inputs) -> list[dict[str, Any]]:
    """Set each run's last estimate beside its true error.

    Returns
    -------
    list of dict
        For each run that estimated its error ``scene``, ``method``, ``patterns`` of the whole run,
        ``target_error``, ``estimated_error``, ``true_error`` and ``true_indirect``: the means over
        relit pictures, and ``ratio`` of estimate to truth; the last three NaN where the truth is
        not known, the ratio also where the error is 0.
    """
    rows = []
    for run in inputs.runs:
        for step in estimates(run.facts["levels"])[-1:]:
            true, estimated = run.facts.get("mean_error", math.nan), step["estimated_error"]
            rows.append({
                "scene": run.scene, "method": run.method, "patterns": run.patterns,
                "target_error": run.facts["options"].get("target_error", math.nan),
                "estimated_error": estimated, "true_error": true,
                "true_indirect": run.facts.get("mean_indirect", math.nan),
                "ratio": estimated / (true or math.nan),
            })  # fmt: skip
    return rows
