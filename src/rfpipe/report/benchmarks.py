"""The section on what `make bench` measured: how time and patterns grow with the rays."""

from __future__ import annotations

from collections.abc import Callable
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

_CURVE: dict[str, Any] = {"marker": "o", "markersize": 4, "linewidth": 1.4}
_FLOOR: dict[str, Any] = {"linestyle": "--", "color": "#5c5c5c", "label": "floor: a copy"}
_COLOURS = ("#1f5a9e", "#c4611a", "#4c8c4a", "#7d5ba6")
# Columns of the table of relighting, and what they are; those that it lacks are not drawn.
_RELIT = {
    "relight_ms": "relight a pattern",
    "batch_ms_per_pattern": "one of a batch",
    "dense_ms": "dense product, numpy",
    "csr_ms": "sparse product (CSR), scipy",
}
# Columns of the table of relighting that are shown, those that are there.
_SHOWN = (
    "rays", "leaves", "store_mb", "factors_mb", "first_relight_ms", "relight_ms",
    "batch_ms_per_pattern", "spot_ms", "copy_ms", "relight_by_copy", "csr_ms", "dense_ms",
)  # fmt: skip


def benchmarks_section(inputs: Inputs) -> Section | None:
    """Return what the benchmarks left, or None where they weren't run."""
    found = inputs.benchmarks
    blocks: list[Block] = []
    drawn = [name for name in _TIMES if name in found]
    if drawn:
        caption = " ".join(["Both axes logarithmic.", *(_TIMES[name][0] for name in drawn)])
        blocks.append(
            Illustration("Time against rays", caption, "time_by_rays", _times(found, drawn))
        )
    blocks += [block_of(found[name]) for name, block_of in _BLOCKS.items() if name in found]
    text = "Measured by `make bench`, apart from the run above, on the machine it ran on."
    sources = [f"bench/{name}.csv" for name in {**_TIMES, **_BLOCKS} if name in found]
    return Section("scale", "Speed and scale", blocks, [text], sources)


_PROCESSING = (
    "Processing: wall milliseconds an HDR image, everything but the simulated capture, by "
    "symmetric photography in RGB through a camera with noise; dashed the floor, one pass over the "
    "image's raw bracket, radiance and variance at the machine's copying speed."
)
_RELIGHTING = (
    "Relighting: milliseconds of a warm call; dashed the floor, a copy of the factors as float32 "
    "numbers; and the products with T itself where it fits."
)


def _times(found: dict[str, pd.DataFrame], drawn: list[str]) -> Figure:
    """Draw processing and relighting against the rays, as far as they were measured."""
    figure, axes = new_figure(1, len(drawn), (4.5 * len(drawn), 3.6))
    for axis, name in zip(axes[0], drawn, strict=True):
        _, draw, label = _TIMES[name]
        draw(axis, found[name])
        logarithmic(axis)
        axis.set_xlabel("rays", fontsize=8.5)
        axis.set_ylabel(label, fontsize=8.5)
        axis.legend(fontsize=8, frameon=False)
    return figure


def _draw_processing(axis: Axes, table: pd.DataFrame) -> None:
    scenes = table.groupby("scene", sort=False)
    for (scene, rows), colour in zip(scenes, _COLOURS, strict=False):
        milliseconds = 1e3 * rows["processing_s_per_image"]
        axis.plot(rows["rays"], milliseconds, color=colour, label=words(scene), **_CURVE)
    floor = table.sort_values("rays")
    axis.plot(floor["rays"], 1e3 * floor["floor_s_per_image"], **_FLOOR)


def _draw_relighting(axis: Axes, table: pd.DataFrame) -> None:
    for (column, label), colour in zip(_RELIT.items(), _COLOURS, strict=True):
        if column in table:
            rows = table.dropna(subset=[column])
            axis.plot(rows["rays"], rows[column], color=colour, label=label, **_CURVE)
    if "copy_ms" in table:
        axis.plot(table["rays"], table["copy_ms"], **_FLOOR)


_TIMES = {
    "scaling": (_PROCESSING, _draw_processing, "processing, ms an HDR image"),
    "relight": (_RELIGHTING, _draw_relighting, "relighting, ms a pattern"),
}


def _scaling(found: pd.DataFrame) -> Tabulation:
    lengths = found[["views", "height", "width"]].to_numpy(int)
    sizes = [size(*(row if row[0] > 1 else row[1:])) for row in lengths]
    times = found["processing_s_per_image"] / found["floor_s_per_image"]
    table = table_of(
        found.assign(size=sizes, times=times),
        [("scene", "scene", words), ("size", "size", str)],
        [
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
        csv="bench_scaling.csv",
        numbers=found,
    )
    caption = (
        "In one process on all cores, stage by stage on files; the peak of memory includes the "
        "simulated scene. 1 MB = 10⁶ bytes."
    )
    return Tabulation("Processing", caption, table)


def _relight(found: pd.DataFrame) -> Tabulation:
    shown = found[[column for column in _SHOWN if column in found]]
    caption = "Milliseconds a pattern, and the floor."
    return Tabulation("Relighting", caption, _plain_table(shown, "relight", found))


def _storage(found: pd.DataFrame) -> Tabulation:
    caption = "Ways to store the same transport; the error is what they add."
    return Tabulation("Storage", caption, _plain_table(found, "storage", found))


def _merge(found: pd.DataFrame) -> Tabulation:
    caption = "Milliseconds an HDR image, by who does the work."
    return Tabulation("Merge and normalize", caption, _plain_table(found, "merge", found))


def _plain_table(shown: pd.DataFrame, name: str, numbers: pd.DataFrame) -> Table:
    """Show a table with the names that its columns have."""
    first, *others = [(words(column), column, _cell) for column in shown]
    return table_of(shown, [first], others, csv=f"bench_{name}.csv", numbers=numbers)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    is_whole = float(value).is_integer()
    return number(value, ",.0f" if is_whole else ".3g")


def _patterns(found: pd.DataFrame) -> Illustration:
    caption = (
        "Scene IV in grey, exact radiance, as Fig. 3.8: left on a linear scale, right with brute "
        "force, which takes one pattern a ray."
    )
    figure = charts.resolution_figure(found)
    return Illustration("Patterns against rays", caption, "patterns_by_rays", figure)


def _overhead(found: pd.DataFrame) -> Tabulation:
    caption = (
        "Means over the jobs of a run of the workflow, in seconds. Of a job's wall time, as "
        "Snakemake measures it, what the stage itself did is its own work; the rest is starting "
        "Python, loading libraries and compiled kernels, and Snakemake's part. Last, the whole "
        "run's wall time times its cores, over the jobs: cores that wait count as overhead there."
    )
    columns = [
        ("jobs", "jobs", number),
        ("a job", "job_s", fixed(2)),
        ("own work", "own_s", fixed(2)),
        ("overhead", "overhead_s", fixed(2)),
    ]
    table = table_of(found, [("stage", "stage", words)], columns, csv="bench_workflow.csv")
    return Tabulation("Overhead", caption, table)


_BLOCKS: dict[str, Callable[[pd.DataFrame], Block]] = {
    "scaling": _scaling,
    "relight": _relight,
    "storage": _storage,
    "merge": _merge,
    "patterns": _patterns,
    "workflow": _overhead,
}
