"""The section on what `make bench` measured: how time and patterns grow with the rays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rfpipe.report import charts
from rfpipe.report.blocks import Block, Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import logarithmic, new_figure
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import fixed, number, size, words

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["benchmarks_section"]

_FLOOR: dict[str, Any] = {"linestyle": "--", "color": "#5c5c5c", "label": "floor: a copy"}
_COLOURS = ("#1f5a9e", "#c4611a", "#4c8c4a", "#7d5ba6")
# Columns of the table of relighting, and what they are; those that it lacks are not drawn.
_RELIT = {
    "relight_ms": "relight a pattern",
    "batch_ms_per_pattern": "one of a batch",
    "dense_ms": "dense product, numpy",
    "csr_ms": "sparse product (CSR), scipy",
}
# Columns of the tables that are shown as they are, those that are there; None: all.
_SHOWN = {
    "relight": (
        "rays", "leaves", "store_mb", "factors_mb", "first_relight_ms", "relight_ms",
        "batch_ms_per_pattern", "spot_ms", "copy_ms", "relight_by_copy", "csr_ms", "dense_ms",
    ),
    "storage": None,
    "merge": None,
}  # fmt: skip
_TABLES = {
    "relight": ("Relighting", "Milliseconds a pattern, and the floor."),
    "storage": ("Storage", "Ways to store the same transport; the error is what they add."),
    "merge": ("Merge and normalize", "Milliseconds an HDR image, by who does the work."),
}


def benchmarks_section(inputs: Inputs) -> Section | None:
    """Return what the benchmarks left, or None where they weren't run."""
    found = inputs.benchmarks
    if not found:
        return None
    blocks: list[Block] = []
    if {"scaling", "relight"} & set(found):
        caption = "Both axes logarithmic. " + " ".join(
            text
            for name, text in (("scaling", _PROCESSING), ("relight", _RELIGHTING))
            if name in found
        )
        blocks.append(Illustration("Time against rays", caption, "time_by_rays", _times(found)))
    if "scaling" in found:
        table = _scaling_table(found["scaling"])
        blocks.append(Tabulation("Processing", _SCALES, table, found["scaling"]))
    for name, (title, caption) in _TABLES.items():
        if name in found:
            table = _plain_table(found[name], name)
            blocks.append(Tabulation(title, caption, table, found[name]))
    if "patterns" in found:
        figure = charts.resolution_figure(found["patterns"].to_dict("records"))
        blocks.append(Illustration("Patterns against rays", _PATTERNS, "patterns_by_rays", figure))
    if "workflow" in found:
        table = _overhead_table(found["workflow"])
        blocks.append(Tabulation("Overhead", _OVERHEAD, table, found["workflow"]))
    text = "Measured by `make bench`, apart from the run above, on the machine it ran on."
    return Section("scale", "Speed and scale", [text], blocks)


_PROCESSING = (
    "Processing: wall milliseconds an HDR image, everything but the simulated capture, by "
    "symmetric photography in RGB through a camera with noise; dashed the floor, one pass over the "
    "image's raw bracket, radiance and variance at the machine's copying speed."
)
_RELIGHTING = (
    "Relighting: milliseconds of a warm call; dashed the floor, a copy of the factors as float32 "
    "numbers; and the products with T itself where it fits."
)
_SCALES = (
    "In one process on all cores, stage by stage on files; the peak of memory includes the "
    "simulated scene. 1 MB = 10⁶ bytes."
)
_PATTERNS = (
    "Scene IV in grey, exact radiance, as Fig. 3.8: left on a linear scale, right with brute "
    "force, which takes one pattern a ray."
)
_OVERHEAD = (
    "Means over the jobs of a run of the workflow, in seconds. Of a job's wall time, as Snakemake "
    "measures it, what the stage itself did is its own work; the rest is starting Python, loading "
    "libraries and compiled kernels, and Snakemake's part. Last, the whole run's wall time times "
    "its cores, over the jobs: cores that wait count as overhead there."
)


def _times(found: dict[str, pd.DataFrame]) -> Figure:
    """Draw processing and relighting against the rays, as far as they were measured."""
    drawn = [
        draw
        for name, draw in (("scaling", _draw_processing), ("relight", _draw_relighting))
        if name in found
    ]
    figure, axes = new_figure(1, len(drawn), (4.5 * len(drawn), 3.6))
    for axis, draw in zip(axes[0], drawn, strict=True):
        draw(axis, found)
        logarithmic(axis)
        axis.set_xlabel("rays", fontsize=8.5)
        axis.legend(fontsize=8, frameon=False)
    return figure


def _draw_processing(axis: Axes, found: dict[str, pd.DataFrame]) -> None:
    table = found["scaling"]
    scenes = table.groupby("scene", sort=False)
    for (scene, rows), colour in zip(scenes, _COLOURS, strict=False):
        rays = rows["rays"]
        axis.plot(rays, 1e3 * rows["processing_s_per_image"], "o-", color=colour, markersize=4,
                  linewidth=1.4, label=words(scene))  # fmt: skip
    floor = table.sort_values("rays")
    axis.plot(floor["rays"], 1e3 * floor["floor_s_per_image"], **_FLOOR)
    axis.set_ylabel("processing, ms an HDR image", fontsize=8.5)


def _draw_relighting(axis: Axes, found: dict[str, pd.DataFrame]) -> None:
    table = found["relight"]
    for (column, label), colour in zip(_RELIT.items(), _COLOURS, strict=True):
        if column in table:
            rows = table.dropna(subset=[column])
            axis.plot(rows["rays"], rows[column], "o-", color=colour, markersize=4,
                      linewidth=1.4, label=label)  # fmt: skip
    if "copy_ms" in table:
        axis.plot(table["rays"], table["copy_ms"], **_FLOOR)
    axis.set_ylabel("relighting, ms a pattern", fontsize=8.5)


def _scaling_table(found: pd.DataFrame) -> Table:
    sizes = [
        size(*([int(views)] if views > 1 else []), int(height), int(width))
        for views, height, width in zip(
            found["views"], found["height"], found["width"], strict=True
        )
    ]
    times = found["processing_s_per_image"] / found["floor_s_per_image"]
    return table_of(
        found.assign(size=sizes, times=times).to_dict("records"),
        [
            ("scene", "scene", words),
            ("size", "size", str),
            ("rays", "rays", number),
            ("tolerance", "tolerance", "{:g}".format),
            ("patterns", "patterns", number),
            ("processing", "processing_s_per_image", fixed(1, 1000)),
            ("floor", "floor_s_per_image", fixed(3, 1000)),
            ("times the floor", "times", number),
            ("stored", "stored_mb", fixed(1)),
            ("peak memory", "peak_mb", number),
        ],
        [("", 5), ("ms an HDR image", 2), ("", 1), ("MB", 2)],
        text_columns=2,
        csv="bench_scaling.csv",
    )


def _overhead_table(found: pd.DataFrame) -> Table:
    return table_of(
        found.to_dict("records"),
        [
            ("stage", "stage", words),
            ("jobs", "jobs", number),
            ("a job", "job_s", fixed(2)),
            ("own work", "own_s", fixed(2)),
            ("overhead", "overhead_s", fixed(2)),
        ],
        csv="bench_workflow.csv",
    )


def _plain_table(found: pd.DataFrame, name: str) -> Table:
    """Show a table, or its most telling columns, with the names that they have."""
    shown = [column for column in _SHOWN[name] or found.columns if column in found]
    columns = [(words(column), column, _cell) for column in shown]
    return table_of(found.to_dict("records"), columns, csv=f"bench_{name}.csv")


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    is_whole = float(value).is_integer()
    return number(value, ",.0f" if is_whole else ".3g")
