"""Errors against pictures on the rig, true and estimated, and errors by relighting pattern."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf, nan
from typing import TYPE_CHECKING, Any

from rfpipe.report.drawing import scene_curves
from rfpipe.report.inputs import RelitAcquisition, ReportInputs, SeedGroup
from rfpipe.report.page import Block, Column, Illustration, Section, table_of
from rfpipe.report.text import ERROR, fixed, indirect_percent, rounded_percent, words
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.transport.base import HISTORY_COLUMNS, estimates

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "#5c5c5c"
_FILLING = 0.35
"""Opacity of the inside of a mark, so that marks below it stay visible."""

_ESTIMATED: dict[str, Any] = {
    "linestyle": ":", "linewidth": 1.1, "marker": "x", "markersize": 4.5,
}  # fmt: skip


def speed_section(inputs: ReportInputs) -> Section | None:
    """Return the section of errors: level by level, true and estimated, and by pattern."""
    table, steps = known_errors(inputs), histories(inputs)
    names = {*table["scene"], *steps["scene"]}
    if not names:
        return None
    groups = [group for group in inputs.seed_groups if names & {*group.scenes}]
    caption = (
        "Mean error of relit pictures against the number of pictures on the rig for all purposes, "
        "for an acquisition that ends after each level. Filled marks: methods that fit all their "
        "pictures together, whose error is known only after their last level. Crosses: the mean "
        "error as the method estimated it during the acquisition. "
    )
    if any(is_verified_alone(run) for run in inputs.runs):
        caption += "Real scenes: error of verification pictures. "
    if any(len(group.scenes) > 1 for group in groups):
        caption += "Means over seeds; bars: standard deviations. "
    caption += "Numbers: tables/speed_error.csv."
    figure = speed_figure(inputs, groups, table, steps)
    name = "Speed against error"
    blocks: list[Block] = [Illustration(name, caption, "speed_error", figure)]
    if len(inputs.errors):
        table_caption = (
            f"{ERROR}; means over shapes, bars and spots, and single patterns. Plain error: "
            "relative to the picture's norm alone, which is larger for dark pictures. Error of "
            "indirect light: on pixels that a pattern leaves dark, relative to the light there; "
            "coaxial rigs only."
        )
        columns: list[Column] = [
            ("error, %", "error", rounded_percent),
            ("plain error, %", "plain_error", rounded_percent),
            ("error of indirect light, %", "indirect_error", indirect_percent),
            ("CIEDE2000", "ciede2000", fixed(2)),
        ]
        labels = [*inputs.labels, ("pattern", "pattern", words)]
        tabled = table_of("Errors by pattern", table_caption, inputs.errors, labels, columns)
        blocks.append(replace(tabled, csv="errors.csv", numbers=None))
    return Section("speed", name, blocks)


def is_verified_alone(run: RelitAcquisition) -> bool:
    """Test whether the error of a run is known from verification pictures only."""
    return not run.has_truth and run.verified.get("mean_error") is not None


def known_errors(inputs: ReportInputs) -> pd.DataFrame:
    """Return the speed table, with a row for each run whose error only verification measured."""
    import pandas as pd

    verified = [
        {"scene": run.scene, "method": run.method, "patterns": run.patterns,
         "pictures": _pictures(inputs, run), "error": run.verified["mean_error"]}
        for run in inputs.runs
        if is_verified_alone(run)
    ]  # fmt: skip
    if not verified:
        return inputs.speed_error
    return pd.concat([inputs.speed_error, pd.DataFrame(verified)], ignore_index=True)


def _pictures(inputs: ReportInputs, run: RelitAcquisition, last_level: float = inf) -> float:
    """Return the number of pictures on the rig up to a level; NaN without captures."""
    folder = FolderStorage(inputs.results / run.scene / run.method)
    return captured_pictures(folder, last_level).total or nan


def speed_figure(
    inputs: ReportInputs, groups: Sequence[SeedGroup], table: pd.DataFrame, steps: pd.DataFrame
) -> Figure:
    """Draw the errors of the speed table and the estimates of `histories`, a panel a group."""
    labelled = {*table["method"]}

    def draw_group(axis: Axes, group: SeedGroup) -> None:
        for method, rows in _of_group(table, group):
            _draw_curve(axis, over_seeds(rows, "error"), inputs.style(method))
        for method, rows in _of_group(steps, group):
            name = {"label": "_" if method in labelled else inputs.title(method)}
            style = {**inputs.style(method), **_ESTIMATED, **name}
            _draw_bars(axis, over_seeds(rows, "estimated_error"), style)
        brute: dict[str, Any] = {"color": _GREY, "linewidth": 0.9, "linestyle": "-."}
        rays = inputs.of_scene(group.scenes[0])[0].rays
        axis.axvline(rays, label="patterns of brute force, alone", **brute)
        if len(steps):
            axis.plot([], [], label="as the method estimated it", color=_GREY, **_ESTIMATED)

    return scene_curves([(group.title, group) for group in groups], draw_group)


def _of_group(table: pd.DataFrame, group: SeedGroup) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield each method and its rows of the scenes of a group."""
    chosen = table[table["scene"].isin(group.scenes)]
    for method, rows in chosen.groupby("method", sort=False):
        yield str(method), rows


def _draw_curve(axis: Axes, rows: pd.DataFrame, style: Mapping[str, Any]) -> None:
    """Draw a method's true errors; a single error as a large filled mark."""
    if len(rows) == 1:
        filled = {"markerfacecolor": (style["color"], _FILLING), "markersize": 8, "linestyle": ""}
        style = {**style, **filled, "marker": style["marker"] or "o"}
    _draw_bars(axis, rows, style)


def _draw_bars(axis: Axes, rows: pd.DataFrame, style: Mapping[str, Any]) -> None:
    """Draw errors against pictures, both with their standard deviations where there are any."""
    spread: dict[str, Any] = {
        direction: rows[name].fillna(0) if rows[name].notna().any() else None
        for direction, name in (("xerr", "pictures_sd"), ("yerr", "error_sd"))
    }
    lines: dict[str, Any] = {"elinewidth": 0.9, "capsize": 2}
    axis.errorbar(rows["pictures"], rows["error"], **spread, **lines, **style)


def over_seeds(rows: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return means and standard deviations over seeds of a method's steps, errors in per cent.

    Parameters
    ----------
    rows : DataFrame
        ``scene``, ``pictures`` and the column, for a method; the steps of each scene in order.
    column : str
        Errors as fractions.

    Returns
    -------
    DataFrame
        ``pictures``, ``error``, ``pictures_sd`` and ``error_sd``, one row per step; the deviations
        are NaN for a single scene.
    """
    step = rows.groupby("scene", sort=False).cumcount()
    groups = rows.assign(error=100 * rows[column]).groupby(step)[["pictures", "error"]]
    return groups.mean().join(groups.std().add_suffix("_sd"))


def histories(inputs: ReportInputs) -> pd.DataFrame:
    """Return the error estimates of all runs.

    Returns
    -------
    DataFrame
        ``scene``, ``method``, ``pictures`` on the rig and `HISTORY_COLUMNS`. Rows that repeat the
        estimate of the previous level are omitted: levels that refine a hierarchy, and fits to more
        pictures that are worse.
    """
    import pandas as pd

    rows = [
        {"scene": run.scene, "method": run.method,
         "pictures": _pictures(inputs, run, step["level"]), **step}
        for run in inputs.runs
        for step in made_estimates(run.facts["levels"])
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["scene", "method", "pictures", *HISTORY_COLUMNS])


def made_estimates(level_rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the `estimates` that differ from the previous one."""
    steps = estimates(level_rows)
    previous = [None, *(step["estimated_error"] for step in steps[:-1])]
    pairs = zip(steps, previous, strict=True) if steps else ()
    return [step for step, error in pairs if step["estimated_error"] != error]
