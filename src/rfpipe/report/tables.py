"""The report's tables of the acquired scenes: numbers for CSV files, and the same as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rfpipe.report import methods
from rfpipe.report.blocks import Column, Table, table_of
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import fixed, number, percent, ray_size, words

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "cost_table",
    "costs",
    "errors_by_pattern",
    "levels_table",
    "processing_table",
    "results",
    "results_table",
    "speed_table",
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
        the run's processing jobs, NaN where they left none. ``capture_jobs_s``: wall seconds of
        the capture as it ran. ``verified_error``, ``verified_worst_error``: of pictures that no
        method saw, None where none were taken. ``minutes`` of both; of the capture alone where
        that is all that is known.
    """
    return [_cost(inputs, run) for run in inputs.runs]


def _cost(inputs: Inputs, run: Run) -> dict[str, Any]:
    height, width = run.settings.shape
    channels, camera_rays = run.settings.channels, math.prod(run.settings.camera_ray_shape)
    capture = run.patterns * inputs.config.capture.seconds_per_pattern
    simulated, processing = _job_seconds(inputs, run)
    return {
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
        "capture_jobs_s": simulated,
        "verified_error": run.verified.get("mean_error"),
        "verified_worst_error": run.verified.get("worst_error"),
        "processing_s": processing,
        "minutes": (capture + (0.0 if math.isnan(processing) else processing)) / 60,
    }


def _job_seconds(inputs: Inputs, run: Run) -> tuple[float, float]:
    """Return the wall seconds of a run's capture and processing jobs; NaN without any."""
    jobs = run.own(inputs.times)
    is_capture = jobs["stage"] == "capture"
    capture, processing = (
        jobs["seconds"][chosen].sum(min_count=1) for chosen in (is_capture, ~is_capture)
    )
    return capture, processing


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


def results_table(inputs: Inputs, found: pd.DataFrame) -> Table:
    """Return patterns, minutes, bytes and errors of each run, as `results` found, on one line."""
    columns: list[Column] = [
        ("patterns", "patterns", number),
        ("time, min", "minutes", fixed(1)),
        ("stored, MB", "megabytes", fixed(2)),
        ("mean", "mean_error", percent),
        ("largest", "worst_error", percent),
        ("mean on unlit pixels", "unlit_error", percent),
    ]
    groups = [("", 2), ("cost", 3), ("error of relit pictures, %", 3)]
    if not inputs.has_truth:
        columns, groups = columns[:3], []
        if any(run.verified for run in inputs.runs):
            groups = [("", 2), ("cost", 3), ("error of pictures that no method saw, %", 2)]
            columns += [
                ("mean", "verified_error", percent),
                ("largest", "verified_worst_error", percent),
            ]
    return table_of(found, inputs.labels, columns, groups, csv="results.csv")


def cost_table(inputs: Inputs) -> Table:
    """Return size, time and patterns of each run beside those of brute force."""
    scenes, per_pattern = inputs.config.scenes, inputs.config.capture.seconds_per_pattern
    rows = [
        {**row, "brute_force_days": row["rays"] * per_pattern / 86_400} for row in costs(inputs)
    ]
    return table_of(
        rows,
        inputs.labels,
        [
            ("rays", "scene", lambda scene: ray_size(scenes[scene])),
            ("size, MB", "megabytes", fixed(2)),
            ("time, min", "minutes", fixed(1)),
            ("patterns", "patterns", number),
            ("size, TB", "dense_terabytes", _significant),
            ("time, days", "brute_force_days", _significant),
            ("patterns", "rays", number),
        ],
        [("", 3), ("acquired", 3), ("brute-force scan", 3)],
        csv="costs.csv",
    )


def _significant(value: Any) -> str:
    """Return a number with about two digits that say something, and all before the point."""
    large = value is not None and abs(value) >= 10
    return number(value, ",.0f" if large else ".2g")


def errors_by_pattern(inputs: Inputs) -> Table:
    """Return total and unlit error of each run under each relighting pattern."""
    names = list(dict.fromkeys(inputs.errors["pattern"]))
    kinds = ["rms_total", "rms_unlit"]
    table = inputs.errors.pivot(index=["scene", "method"], columns="pattern", values=kinds)
    errors = table.to_dict("index")
    return table_of(
        [
            {"scene": run.scene, "method": run.method, **errors[run.scene, run.method]}
            for run in inputs.runs
        ],
        inputs.labels,
        [(words(name), (kind, name), percent) for kind in kinds for name in names],
        [
            ("", 2),
            ("relative RMS error in total, %", len(names)),
            ("on the unlit pixels, %", len(names)),
        ],
        csv="errors.csv",
        numbers=inputs.errors,
        is_written=True,
    )


def levels_table(inputs: Inputs) -> Table:
    """Return the sums of all runs' levels over scenes; the CSV file has each run's own."""
    import pandas as pd

    numbers = pd.DataFrame(
        [
            {"scene": run.scene, "method": run.method, "rank_k": 0, **row}
            for run in inputs.runs
            for row in run.facts["levels"]
        ]
    )
    # the second level of a light field has whole views
    fields = numbers["scene"].isin([run.scene for run in inputs.light_fields])
    kinds = ["patterns", "nodes", "empty", "rank1", "rank_k", "scalar", "subdivided"]
    sums = numbers.groupby([fields, "method", "level"], sort=False)[kinds].sum().reset_index()
    suffix = sums["scene"].map({True: ", light fields", False: ""})
    names = {"rank1": "rank-1 or stored", "rank_k": "rank-k"}
    return table_of(
        sums.assign(method=sums["method"].map(methods.title) + suffix),
        [("method", "method", str)],
        [("level", "level", str), *((names.get(kind, kind), kind, number) for kind in kinds)],
        csv="levels.csv",
        numbers=numbers,
    )


def speed_table(inputs: Inputs) -> Table:
    """Return patterns and error after each level."""
    return table_of(
        inputs.speed_error,
        inputs.labels,
        [
            ("level", "level", str),
            ("patterns", "patterns", number),
            ("capture, min", "capture_s", fixed(1, 1 / 60)),
            ("error, %", "error", percent),
        ],
        csv="speed_error.csv",
        is_written=True,
    )


def processing_table(inputs: Inputs) -> Table:
    """Return the processing seconds of each run, and a HDR image."""
    numbers = []
    for run in inputs.runs:
        simulated, seconds = _job_seconds(inputs, run)
        numbers.append(
            {
                "scene": run.scene, "method": run.method, "patterns": run.patterns,
                "capture_jobs_s": simulated, "processing_jobs_s": seconds,
                "processing_jobs_s_per_image": seconds / run.patterns,
            }
        )  # fmt: skip
    return table_of(
        numbers,
        inputs.labels,
        [
            ("HDR images", "patterns", number),
            (f"{inputs.capture_named}, s", "capture_jobs_s", fixed(1)),
            ("processing, s", "processing_jobs_s", fixed(1)),
            ("ms an image", "processing_jobs_s_per_image", fixed(1, 1000)),
        ],
        csv="processing.csv",
    )
