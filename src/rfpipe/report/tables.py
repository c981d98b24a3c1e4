"""The report's tables of the acquired scenes: numbers for CSV files, and the same as text."""

from __future__ import annotations

import math
from collections.abc import Callable
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
        no benchmark files; NaN without either. ``capture_jobs_s``: wall seconds of the capture
        as it ran. ``verified_error``, ``verified_worst_error``: of pictures that no method saw,
        None where none were taken. ``minutes`` of both; of the capture alone where
        that is all that is known.
    """
    return [_cost(inputs, run) for run in inputs.runs]


def _cost(inputs: Inputs, run: Run) -> dict[str, Any]:
    height, width = run.settings.shape
    channels, camera_rays = run.settings.channels, math.prod(run.settings.camera_ray_shape)
    capture = run.patterns * inputs.config.capture.seconds_per_pattern
    simulated, processing = _job_seconds(inputs, run)
    if math.isnan(processing):
        processing = _in_process_seconds(inputs, run)
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


def _in_process_seconds(inputs: Inputs, run: Run) -> float:
    """Return the processing seconds of a run's acquisition within the sweep; NaN without one."""
    own = run.own(inputs.speed_error)
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


def table_5_1(inputs: Inputs) -> Table:
    """Table 5.1: cost of symmetric photography here and in the thesis."""
    scenes = inputs.config.scenes
    ours = [(row, row_of(scenes[row["scene"]])) for row in _costs_of(inputs, "5.1")]
    shown = {name for _, name in ours}
    theirs = [({"title": name}, name) for name in TABLE_5_1 if name not in shown]
    return table_of(
        [{**row, **_thesis_numbers(name)} for row, name in [*ours, *theirs]],
        [("scene", "title", str)],
        [
            ("rays", "scene", _ray_sizes(inputs)),
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


def _costs_of(inputs: Inputs, table: str) -> list[dict[str, Any]]:
    """Return the costs of a thesis table's runs."""
    shown = methods.of_table(table, inputs.methods)
    return [row for row in costs(inputs) if row["method"] in shown]


def _ray_sizes(inputs: Inputs) -> Callable[[str | None], str]:
    """Return what makes of a scene's name the size of its rays; a dash of None."""
    scenes = inputs.config.scenes
    return lambda scene: DASH if scene is None else ray_size(scenes[scene])


def _thesis_numbers(name: str | None) -> dict[str, Any]:
    numbers = vars(TABLE_5_1[name]) if name else {}
    return {f"thesis_{key}": value for key, value in numbers.items()}


def table_3_1(inputs: Inputs) -> Table:
    """Table 3.1: cost of dual photography here and, for other scenes, in the thesis."""
    per_pattern = inputs.config.capture.seconds_per_pattern
    ours = [
        {**row, "brute_force_days": row["rays"] * per_pattern / 86_400}
        for row in _costs_of(inputs, "3.1")
    ]
    theirs = [{"title": f"thesis: {name}", **vars(found)} for name, found in TABLE_3_1.items()]
    return table_of(
        [*ours, *theirs],
        [("scene", "title", str)],
        [
            ("rays", "scene", _ray_sizes(inputs)),
            ("size, TB", "dense_terabytes", _significant),
            ("time, days", "brute_force_days", _significant),
            ("size, MB", "megabytes", _significant),
            ("time, min", "minutes", _significant),
            ("patterns", "patterns", number),
        ],
        [("", 2), ("brute-force scan", 2), ("dual photography", 3)],
        csv="table_3_1.csv",
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
    """Return cost and mean errors at each value of the sweep."""
    columns = ["scene", "method", "option", "value"]
    means = inputs.speed_error.drop(columns="pattern").groupby(columns, sort=False).mean()
    means["asked"] = [f"{words(option)} {value:g}" for _, _, option, value in means.index]
    return table_of(
        means.reset_index(),
        inputs.labels,
        [
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
        csv="speed_error.csv",
        numbers=inputs.speed_error,
        is_written=True,
    )


def processing_table(inputs: Inputs) -> Table:
    """Return the processing seconds of each run, and a HDR image."""
    numbers = []
    for run in inputs.runs:
        simulated, seconds = _job_seconds(inputs, run)
        alone = _in_process_seconds(inputs, run)
        numbers.append(
            {
                "scene": run.scene, "method": run.method, "patterns": run.patterns,
                "capture_jobs_s": simulated, "processing_jobs_s": seconds,
                "processing_jobs_s_per_image": seconds / run.patterns,
                "processing_in_process_s": alone,
                "processing_in_process_s_per_image": alone / run.patterns,
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
            ("processing, s", "processing_in_process_s", fixed(2)),
            ("ms an image", "processing_in_process_s_per_image", fixed(1, 1000)),
        ],
        [("", 3), ("stages on files", 3), ("in memory", 2)],
        csv="processing.csv",
    )
