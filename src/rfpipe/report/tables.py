"""The report's tables: numbers for CSV files, and the same as text for the page."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rfpipe.report.inputs import METHOD_TITLES, Inputs
from rfpipe.report.text import DASH, TIMES, number, percent, ray_size, size
from rfpipe.report.thesis import PLANES_SHAPE, TABLE_3_1, TABLE_5_1, row_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Table",
    "costs",
    "error_summary",
    "errors_by_pattern",
    "levels_table",
    "processing_table",
    "speed_table",
    "table_3_1",
    "table_5_1",
]

_FLOAT_BYTES = 4


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes
    ----------
    groups : list of (str, int)
        Headings over so many columns each; may be empty.
    columns : list of str
    rows : list of list of str
    text_columns : int
        Columns from the left that hold text rather than numbers.
    csv : str
        Name of the CSV file beside it, or "".
    """

    groups: list[tuple[str, int]]
    columns: list[str]
    rows: list[list[str]]
    text_columns: int = 1
    csv: str = field(default="")


def costs(inputs: Inputs) -> list[dict[str, Any]]:
    """Return what each run cost.

    Returns
    -------
    list of dict
        For each run ``scene``, ``title``, ``method``, ``views``, ``height``, ``width``,
        ``channels``, ``rays``, ``patterns``, ``megabytes`` (10^6 bytes on disk),
        ``dense_terabytes`` of T as float32,
        ``capture_s`` at the rig's stated seconds a pattern, ``processing_s``: wall seconds of
        the run's processing jobs, or of the same acquisition within the sweep where there are
        no benchmark files; NaN without either.
    """
    rows: list[dict[str, Any]] = []
    per_pattern = inputs.config.capture.seconds_per_pattern
    for run in inputs.runs:
        height, width = run.settings.shape
        channels = run.settings.channels
        rows.append(
            {
                "scene": run.scene,
                "title": run.title,
                "method": run.method,
                "views": math.prod(run.settings.views or (1,)),
                "height": height,
                "width": width,
                "channels": channels,
                "rays": run.rays,
                "patterns": run.patterns,
                "megabytes": run.facts["bytes"] / 1e6,
                "dense_terabytes": run.rays**2 * channels * _FLOAT_BYTES / 1e12,
                "capture_s": run.patterns * per_pattern,
                "processing_s": _processing_seconds(inputs, run.scene, run.method),
            }
        )
    return rows


def _processing_seconds(inputs: Inputs, scene: str, method: str) -> float:
    times = inputs.times
    own = times[(times["scene"] == scene) & (times["method"] == method)]
    own = own[own["stage"] != "capture"]
    if len(own):
        return float(own["seconds"].sum())
    return in_process_seconds(inputs, scene, method)


def in_process_seconds(inputs: Inputs, scene: str, method: str) -> float:
    """Return the processing seconds of a run's acquisition within the sweep; NaN without one."""
    table = inputs.speed_error
    own = table[(table["scene"] == scene) & (table["method"] == method)]
    section = inputs.config.methods_of(scene)[method]
    at = own[own["value"] == section.options().get(section.subject(method).trades)]
    return float(at["processing_s"].iloc[0]) if len(at) else float("nan")


def table_5_1(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Table 5.1: cost of symmetric photography here and in the thesis."""
    import pandas as pd

    ours = [row for row in costs(inputs) if row["method"] == "symmetric"]
    rows: list[list[str]] = []
    csv: list[dict[str, Any]] = []
    used = set()
    for row in ours:
        name = row_of(inputs.config.scenes[row["scene"]])
        thesis = TABLE_5_1[name] if name else None
        used.add(name)
        minutes = (row["capture_s"] + row["processing_s"]) / 60
        rows.append(
            [
                row["title"],
                ray_size(inputs.config.scenes[row["scene"]]),
                number(row["megabytes"], ".2f"),
                number(minutes, ".1f"),
                number(row["patterns"]),
                number(row["rays"]),
                *_thesis_cells(thesis),
            ]
        )
        csv.append({**row, "minutes": minutes, **_thesis_numbers(thesis)})
    for name, thesis in TABLE_5_1.items():
        if name not in used:
            rows.append([name, *[DASH] * 5, *_thesis_cells(thesis)])
            csv.append({"title": name, **_thesis_numbers(thesis)})
    table = Table(
        [("", 1), ("here", 5), (f"thesis, planes at {size(*PLANES_SHAPE)}", 4)],
        ["scene", "rays", "size, MB", "time, min", "patterns", "brute force",
         "size, MB", "time, min", "patterns", "brute force"],
        rows,
        csv="table_5_1.csv",
    )  # fmt: skip
    return table, pd.DataFrame(csv)


def _thesis_cells(thesis: Any) -> list[str]:
    if thesis is None:
        return [DASH] * 4
    values = (thesis.megabytes, thesis.minutes, thesis.patterns, thesis.brute_force_patterns)
    return [number(value) for value in values]


def _thesis_numbers(thesis: Any) -> dict[str, Any]:
    if thesis is None:
        return {}
    return {f"thesis_{name}": value for name, value in vars(thesis).items()}


def table_3_1(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Table 3.1: cost of dual photography here and, for other scenes, in the thesis."""
    import pandas as pd

    ours = [row for row in costs(inputs) if row["method"] == "dual"]
    per_pattern = inputs.config.capture.seconds_per_pattern
    rows: list[list[str]] = []
    csv: list[dict[str, Any]] = []
    for row in ours:
        minutes = (row["capture_s"] + row["processing_s"]) / 60
        days = row["rays"] * per_pattern / 86_400
        rows.append(
            [
                row["title"],
                ray_size(inputs.config.scenes[row["scene"]]),
                number(row["dense_terabytes"], ".2g"),
                number(days, ".2f"),
                number(row["megabytes"], ".1f"),
                number(minutes, ".1f"),
                number(row["patterns"]),
            ]
        )
        csv.append({**row, "minutes": minutes, "brute_force_days": days})
    for name, thesis in TABLE_3_1.items():
        rows.append(
            [
                f"thesis: {name}",
                DASH,
                number(thesis.brute_force_terabytes, "g"),
                number(thesis.brute_force_days, "g"),
                number(thesis.megabytes),
                number(thesis.minutes),
                number(thesis.patterns),
            ]
        )
        csv.append({"title": f"thesis: {name}", **vars(thesis)})
    table = Table(
        [("", 2), ("brute-force scan", 2), ("dual photography", 3)],
        ["scene", "rays", "size, TB", "time, days", "size, MB", "time, min", "patterns"],
        rows,
        csv="table_3_1.csv",
    )
    return table, pd.DataFrame(csv)


def error_summary(inputs: Inputs) -> Table:
    """Return patterns, cost and errors of each run on one line."""
    worst = inputs.errors.groupby(["scene", "method"], sort=False)
    high = worst[["rms_total", "rms_unlit", "ciede2000"]].max()
    low = worst["psnr_db"].min()
    rows = []
    for row in costs(inputs):
        key = (row["scene"], row["method"])
        total, unlit, colour = high.loc[key] if key in high.index else [None] * 3
        rows.append(
            [
                row["title"],
                METHOD_TITLES[row["method"]],
                number(row["patterns"]),
                number(row["rays"] / row["patterns"], ".0f") + TIMES,
                number(row["capture_s"] / 60, ".1f"),
                number(row["megabytes"], ".2f"),
                percent(total),
                percent(unlit),
                number(low.get(key), ".1f"),
                number(colour, ".2f"),
            ]
        )
    return Table(
        [("", 2), ("cost", 4), ("worst of the relighting patterns", 4)],
        ["scene", "method", "patterns", "fewer than brute force", "capture, min", "size, MB",
         "total error, %", "unlit error, %", "PSNR, dB", "CIEDE2000"],
        rows,
        text_columns=2,
        csv="errors.csv",
    )  # fmt: skip


def errors_by_pattern(inputs: Inputs) -> Table:
    """Return total and unlit error of each run under each relighting pattern."""
    names = list(dict.fromkeys(inputs.errors["pattern"]))
    table = inputs.errors.set_index(["scene", "method", "pattern"])
    rows = []
    for run in inputs.runs:
        cells = []
        for column in ("rms_total", "rms_unlit"):
            for name in names:
                key = (run.scene, run.method, name)
                cells.append(percent(table.loc[key, column] if key in table.index else None))
        rows.append([run.title, METHOD_TITLES[run.method], *cells])
    short = [name.replace("_", " ") for name in names]
    return Table(
        [("", 2), ("relative RMS error in total, %", len(names)),
         ("on the unlit pixels, %", len(names))],
        ["scene", "method", *short, *short],
        rows,
        text_columns=2,
        csv="errors.csv",
    )  # fmt: skip


def levels_table(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Return the levels of all runs as numbers, and their sums over scenes as text."""
    import pandas as pd

    numbers = pd.DataFrame(
        [
            {"scene": run.scene, "method": run.method, "rank_k": 0, **row}
            for run in inputs.runs
            for row in run.facts["levels"]
        ]
    )
    kinds = ["patterns", "nodes", "empty", "rank1", "rank_k", "scalar", "subdivided"]
    # the second level of a light field has whole views
    fields = numbers["scene"].isin([run.scene for run in inputs.light_fields])
    sums = numbers.groupby([fields, "method", "level"], sort=False)[kinds].sum()
    rows = [
        [
            METHOD_TITLES[str(method)] + (", light fields" if is_field else ""),
            str(level),
            *(number(value) for value in row),
        ]
        for (is_field, method, level), row in zip(sums.index, sums.to_numpy(), strict=True)
    ]
    names = ["patterns", "nodes", "empty", "rank-1 or stored", "rank-k", "scalar", "subdivided"]
    columns = ["method", "level", *names]
    return Table([], columns, rows, csv="levels.csv"), numbers


def speed_table(inputs: Inputs) -> Table:
    """Return cost and mean errors at each value of the sweep."""
    columns = ["scene", "method", "option", "value"]
    grouped = inputs.speed_error.groupby(columns, sort=False)
    means = grouped[
        ["patterns", "capture_s", "processing_s", "bytes", "rms_total", "rms_unlit", "psnr_db",
         "ciede2000"]
    ].mean()  # fmt: skip
    titles = {run.scene: run.title for run in inputs.runs}
    rows = []
    for (scene, method, option, value), row in zip(
        means.index, means.to_dict("records"), strict=True
    ):
        rows.append(
            [
                titles.get(scene, scene),
                METHOD_TITLES[method],
                f"{option.replace('_', ' ')} {value:g}",
                number(row["patterns"]),
                number(row["capture_s"] / 60, ".1f"),
                number(row["processing_s"], ".2f"),
                number(row["bytes"] / 1e6, ".2f"),
                percent(row["rms_total"]),
                percent(row["rms_unlit"]),
                number(row["psnr_db"], ".1f"),
                number(row["ciede2000"], ".2f"),
            ]
        )
    return Table(
        [("", 3), ("cost", 4), ("mean error", 4)],
        ["scene", "method", "asked for", "patterns", "capture, min", "processing, s", "size, MB",
         "total, %", "unlit, %", "PSNR, dB", "CIEDE2000"],
        rows,
        text_columns=2,
        csv="speed_error.csv",
    )  # fmt: skip


def processing_table(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Return the processing seconds of each run, and a HDR image."""
    import pandas as pd

    rows: list[list[str]] = []
    csv: list[dict[str, Any]] = []
    for run in inputs.runs:
        jobs = inputs.times[
            (inputs.times["scene"] == run.scene) & (inputs.times["method"] == run.method)
        ]
        is_capture = jobs["stage"] == "capture"
        seconds, simulated = (
            float(jobs[chosen]["seconds"].sum()) if len(jobs) else math.nan
            for chosen in (~is_capture, is_capture)
        )
        alone = in_process_seconds(inputs, run.scene, run.method)
        per_image = [value / run.patterns for value in (seconds, alone)]
        rows.append(
            [
                run.title,
                METHOD_TITLES[run.method],
                number(run.patterns),
                number(simulated, ".1f"),
                number(seconds, ".1f"),
                number(per_image[0], ".1f", 1000),
                number(alone, ".2f"),
                number(per_image[1], ".1f", 1000),
            ]
        )
        csv.append(
            {
                "scene": run.scene, "method": run.method, "patterns": run.patterns,
                "capture_jobs_s": simulated, "processing_jobs_s": seconds,
                "processing_jobs_s_per_image": per_image[0], "processing_in_process_s": alone,
                "processing_in_process_s_per_image": per_image[1],
            }
        )  # fmt: skip
    table = Table(
        [("", 3), ("jobs of the workflow", 3), ("in one process", 2)],
        ["scene", "method", "HDR images", "simulated capture, s", "processing, s", "ms an image",
         "processing, s", "ms an image"],
        rows,
        text_columns=2,
        csv="processing.csv",
    )  # fmt: skip
    return table, pd.DataFrame(csv)
