"""The report's tables of the acquired scenes: numbers for CSV files, and the same as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rfpipe.report import methods
from rfpipe.report.blocks import Column, Table, table_of
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import DASH, fixed, number, percent, ray_size, size, words
from rfpipe.report.thesis import PLANES_SHAPE, TABLE_3_1, TABLE_5_1, row_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "costs",
    "errors_by_pattern",
    "levels_table",
    "processing_table",
    "results",
    "results_table",
    "speed_table",
    "table_3_1",
    "table_5_1",
]

_FLOAT_BYTES = 4


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
        no benchmark files; NaN without either. ``minutes`` of both; of the capture alone where
        that is all that is known.
    """
    rows: list[dict[str, Any]] = []
    per_pattern = inputs.config.capture.seconds_per_pattern
    for run in inputs.runs:
        height, width = run.settings.shape
        channels, camera_rays = run.settings.channels, math.prod(run.settings.camera_ray_shape)
        capture = run.patterns * per_pattern
        processing = _processing_seconds(inputs, run)
        rows.append(
            {
                "scene": run.scene,
                "title": run.title,
                "method": run.method,
                "views": math.prod(run.settings.view_grid),
                "height": height,
                "width": width,
                "channels": channels,
                "rays": run.rays,
                "patterns": run.patterns,
                "megabytes": run.facts["bytes"] / 1e6,
                "dense_terabytes": run.rays * camera_rays * channels * _FLOAT_BYTES / 1e12,
                "capture_s": capture,
                "processing_s": processing,
                "minutes": (capture + (0.0 if math.isnan(processing) else processing)) / 60,
            }
        )
    return rows


def _processing_seconds(inputs: Inputs, run: Run) -> float:
    own = inputs.times_of(run)
    own = own[own["stage"] != "capture"]
    return float(own["seconds"].sum()) if len(own) else in_process_seconds(inputs, run)


def in_process_seconds(inputs: Inputs, run: Run) -> float:
    """Return the processing seconds of a run's acquisition within the sweep; NaN without one."""
    table = inputs.speed_error
    own = table[(table["scene"] == run.scene) & (table["method"] == run.method)]
    section = inputs.config.methods_of(run.scene)[run.method]
    at = own[own["value"] == section.options().get(section.subject(run.method).trades)]
    return float(at["processing_s"].iloc[0]) if len(at) else math.nan


def results(inputs: Inputs) -> pd.DataFrame:
    """Return what each run cost and how far off its relit pictures are.

    Returns
    -------
    DataFrame
        The columns of `costs`, and over the relighting patterns ``mean_error`` and
        ``worst_error`` in total, ``unlit_error``: the mean on the unlit pixels, ``psnr_db``: the
        least, ``ciede2000``: the largest; NaN where the truth isn't known.
    """
    import pandas as pd

    errors = inputs.errors.groupby(["scene", "method"], sort=False)
    found = errors.agg(
        mean_error=("rms_total", "mean"),
        worst_error=("rms_total", "max"),
        unlit_error=("rms_unlit", "mean"),
        psnr_db=("psnr_db", "min"),
        ciede2000=("ciede2000", "max"),
    )
    return pd.DataFrame(costs(inputs)).merge(found, how="left", on=["scene", "method"])


def results_table(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Return patterns, minutes, bytes and errors of each run on one line."""
    numbers = results(inputs)
    columns: list[Column] = [
        ("scene", "title", str),
        ("method", "method", methods.title),
        ("patterns", "patterns", number),
        ("time, min", "minutes", fixed(1)),
        ("stored, MB", "megabytes", fixed(2)),
        ("mean", "mean_error", percent),
        ("largest", "worst_error", percent),
        ("mean on unlit pixels", "unlit_error", percent),
    ]
    groups = [("", 2), ("cost", 3), ("error of relit pictures, %", 3)]
    if not inputs.has_truth:
        columns, groups = columns[:5], []
    table = table_of(
        numbers.to_dict("records"), columns, groups,
        text_columns=2, csv="results.csv", is_grouped=True,
    )  # fmt: skip
    return table, numbers


def table_5_1(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Table 5.1: cost of symmetric photography here and in the thesis."""
    import pandas as pd

    numbers: list[dict[str, Any]] = []
    used = set()
    for row in _costs_of(inputs, "5.1"):
        name = row_of(inputs.config.scenes[row["scene"]])
        used.add(name)
        numbers.append({**row, **_thesis_numbers(TABLE_5_1[name] if name else None)})
    numbers += [
        {"title": name, **_thesis_numbers(thesis)}
        for name, thesis in TABLE_5_1.items()
        if name not in used
    ]
    table = table_of(
        numbers,
        [
            ("scene", "title", str),
            ("rays", "size", _or_dash),
            ("size, MB", "megabytes", fixed(2)),
            ("time, min", "minutes", fixed(1)),
            ("patterns", "patterns", number),
            ("brute force", "rays", number),
            ("size, MB", "thesis_megabytes", number),
            ("time, min", "thesis_minutes", number),
            ("patterns", "thesis_patterns", number),
            ("brute force", "thesis_brute_force_patterns", number),
        ],
        [("", 1), ("here", 5), (f"thesis, planes at {size(*PLANES_SHAPE)}", 4)],
        csv="table_5_1.csv",
    )
    return table, pd.DataFrame(numbers).drop(columns="size", errors="ignore")


def _costs_of(inputs: Inputs, table: str) -> list[dict[str, Any]]:
    """Return the costs of a thesis table's runs, each with the size of its rays as text."""
    shown = methods.of_table(table, inputs.methods)
    rows = [row for row in costs(inputs) if row["method"] in shown]
    return [{**row, "size": ray_size(inputs.config.scenes[row["scene"]])} for row in rows]


def _or_dash(text: str | None) -> str:
    return text or DASH


def _thesis_numbers(thesis: Any) -> dict[str, Any]:
    if thesis is None:
        return {}
    return {f"thesis_{name}": value for name, value in vars(thesis).items()}


def table_3_1(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Table 3.1: cost of dual photography here and, for other scenes, in the thesis."""
    import pandas as pd

    per_pattern = inputs.config.capture.seconds_per_pattern
    ours = [
        {**row, "brute_force_days": row["rays"] * per_pattern / 86_400}
        for row in _costs_of(inputs, "3.1")
    ]
    theirs = [
        {
            "title": f"thesis: {name}",
            "dense_terabytes": thesis.brute_force_terabytes,
            "brute_force_days": thesis.brute_force_days,
            "megabytes": thesis.megabytes,
            "minutes": thesis.minutes,
            "patterns": thesis.patterns,
        }
        for name, thesis in TABLE_3_1.items()
    ]
    table = table_of(
        [*ours, *theirs],
        [
            ("scene", "title", str),
            ("rays", "size", _or_dash),
            ("size, TB", "dense_terabytes", _significant),
            ("time, days", "brute_force_days", _significant),
            ("size, MB", "megabytes", _significant),
            ("time, min", "minutes", _significant),
            ("patterns", "patterns", number),
        ],
        [("", 2), ("brute-force scan", 2), ("dual photography", 3)],
        csv="table_3_1.csv",
    )
    return table, pd.DataFrame([*ours, *theirs]).drop(columns="size")


def _significant(value: Any) -> str:
    """Return a number with about two digits that say something, and all before the point."""
    large = value is not None and abs(value) >= 10
    return number(value, ",.0f" if large else ".2g")


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
        rows.append([run.title, methods.title(run.method), *cells])
    short = [name.replace("_", " ") for name in names]
    return Table(
        [("", 2), ("relative RMS error in total, %", len(names)),
         ("on the unlit pixels, %", len(names))],
        ["scene", "method", *short, *short],
        rows,
        text_columns=2,
        csv="errors.csv",
        is_grouped=True,
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
            methods.title(str(method)) + (", light fields" if is_field else ""),
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
    means = inputs.speed_error.drop(columns="pattern").groupby(columns, sort=False).mean()
    titles = {run.scene: run.title for run in inputs.runs}
    means["asked"] = [f"{words(option)} {value:g}" for _, _, option, value in means.index]
    return table_of(
        means.reset_index().to_dict("records"),
        [
            ("scene", "scene", lambda scene: str(titles.get(scene, scene))),
            ("method", "method", methods.title),
            ("asked for", "asked", str),
            ("patterns", "patterns", number),
            ("capture, min", "capture_s", fixed(1, 1 / 60)),
            ("processing, s", "processing_s", fixed(2)),
            ("size, MB", "bytes", fixed(2, 1e-6)),
            ("total, %", "rms_total", percent),
            ("unlit, %", "rms_unlit", percent),
            ("PSNR, dB", "psnr_db", fixed(1)),
            ("CIEDE2000", "ciede2000", fixed(2)),
        ],
        [("", 3), ("cost", 4), ("mean error", 4)],
        text_columns=2,
        csv="speed_error.csv",
        is_grouped=True,
    )


def processing_table(inputs: Inputs) -> tuple[Table, pd.DataFrame]:
    """Return the processing seconds of each run, and a HDR image."""
    import pandas as pd

    numbers = []
    for run in inputs.runs:
        jobs = inputs.times_of(run)
        is_capture = jobs["stage"] == "capture"
        seconds, simulated = (
            float(jobs[chosen]["seconds"].sum()) if len(jobs) else math.nan
            for chosen in (~is_capture, is_capture)
        )
        alone = in_process_seconds(inputs, run)
        numbers.append(
            {
                "scene": run.scene, "method": run.method, "patterns": run.patterns,
                "capture_jobs_s": simulated, "processing_jobs_s": seconds,
                "processing_jobs_s_per_image": seconds / run.patterns,
                "processing_in_process_s": alone,
                "processing_in_process_s_per_image": alone / run.patterns,
            }
        )  # fmt: skip
    titles = {run.scene: run.title for run in inputs.runs}
    table = table_of(
        numbers,
        [
            ("scene", "scene", lambda scene: titles[scene]),
            ("method", "method", methods.title),
            ("HDR images", "patterns", number),
            ("simulated capture, s", "capture_jobs_s", fixed(1)),
            ("processing, s", "processing_jobs_s", fixed(1)),
            ("ms an image", "processing_jobs_s_per_image", fixed(1, 1000)),
            ("processing, s", "processing_in_process_s", fixed(2)),
            ("ms an image", "processing_in_process_s_per_image", fixed(1, 1000)),
        ],
        [("", 3), ("stages on files", 3), ("in memory", 2)],
        text_columns=2,
        csv="processing.csv",
        is_grouped=True,
    )
    return table, pd.DataFrame(numbers)
