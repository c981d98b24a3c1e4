"""The tables of docs/cost.md: what acquisitions cost on a rig, from tables of measurements.

`benchmarks.measured` writes them into the page. Times on the rig are those of all pictures, at
`SECONDS` each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.methods.cases import AUTO, CAMERAS, SIDE, newest
from benchmarks.methods.page import markdown
from benchmarks.methods.scenes import shape_of
from rfpipe.photometry import CameraModel
from rfpipe.stages.forecast import disk_bytes

SECONDS = 2.0
"""Seconds of a picture on the rig, ``capture.seconds_per_pattern`` by default."""

_HOURS = 8  # of a night
_GIB = 2**30
_COSTS = ["pictures", "patterns", "processing_s"]
_SIDES = {"48": "red_wall_box", "96": "red_wall_box", "192": "wedge_aside"}  # scene of each side
_RUNS = {  # of `make thesis` and config/large.yaml, RGB: shape of the rays, and target error
    ("planes_iv", "near_far"): ((310, 350), 0.005),
    ("planes_iv", "near_far_fine"): ((310, 350), 0.0025),
    ("light_field", "auto"): ((9, 130, 200), 0.02),
    ("sweets", "auto"): ((240, 340), 0.01),
    ("still_life", "auto"): ((240, 340), 0.01),
}


def by_target(benchmark: Path) -> str:
    """Return the cost of `AUTO` at the benchmark's side, by light and target.

    Costs are medians over the scenes that were acquired on the last day; settings that ran on less
    than half of them are omitted.

    Parameters
    ----------
    benchmark : Path
        The benchmark's table of acquisitions.
    """
    rows = newest(benchmark)
    rows = rows[(rows["method"] == AUTO) & (rows["side"] == SIDE) & (rows["status"] == "done")]
    rows = rows[rows["date"] == rows["date"].max()]
    lines = []
    for light, target in product(CAMERAS, sorted(set(rows["value"]), reverse=True)):
        setting = rows[(rows["light"] == light) & (rows["value"] == target)]
        if 2 * setting["scene"].nunique() < rows["scene"].nunique():
            continue
        # one number of each scene, whatever the number of its seeds
        of_scenes = setting.groupby(["what", "scene"])[_COSTS].median()
        for what, of_kind in of_scenes.groupby("what"):
            scenes = f"{len(of_kind)} {what}"
            lines.append([light, f"{100 * target:g} %", scenes, *_cells(of_kind.median())])
    head = ["light", "target", "scenes", "pictures (patterns)", "minutes on the rig",
            f"scenes in {_HOURS} hours", "processing, min"]  # fmt: skip
    return markdown(head, lines)


def _cells(cost: Any) -> list[str]:
    """Return a cost, its pictures, patterns and processing seconds, as cells of the table."""
    pictures = cost["pictures"]
    return [
        f"{pictures:.0f} ({cost['patterns']:.0f})",
        _minutes(pictures),
        f"{3600 * _HOURS / (SECONDS * pictures):.0f}",
        f"{cost['processing_s'] / 60:.1f}",
    ]


def by_size(folder: Path) -> str:
    """Return the cost of acquisitions of several sizes.

    Parameters
    ----------
    folder : Path
        Of the tables of docs/measured.md.
    """
    measured = list(_of_sides(folder / "acquisitions.csv"))
    runs = [*_of_runs(folder / "thesis_run.csv"), *_of_runs(folder / "large.csv")]
    stages = pd.read_csv(folder / "large_stages.csv")
    lines = []
    for row in [*measured, *runs]:
        shape, channels, pictures = row["shape"], row["channels"], row["pictures"]
        patterns = row["patterns"]
        disk = disk_bytes(CameraModel(), shape, channels, pictures, patterns)
        seconds = row.get("processing_s", _processing_seconds(stages, row))
        lines.append(
            [" x ".join(map(str, shape)) + (", RGB" if channels == 3 else ""), row["scene"],
             f"{100 * row['target']:g} %", f"{pictures} ({patterns})", _minutes(pictures),
             f"{disk / _GIB:.2g}", f"{row['megabytes']:.3g}",
             "" if math.isnan(seconds) else f"{seconds / 60:.1f}"]
        )  # fmt: skip
    head = ["rays", "scene", "target", "pictures (patterns)", "minutes on the rig", "GiB on disk",
            "MB of transport", "processing, min"]  # fmt: skip
    return markdown(head, lines)


def _of_sides(table: Path) -> Iterator[dict[str, Any]]:
    """Yield the acquisitions by `AUTO` of several sides, grey."""
    rows = newest(table)
    rows = rows[rows["scene"] == rows["side"].map(_SIDES)]
    for row in rows[rows["method"] == AUTO].itertuples():
        yield {
            "shape": shape_of(row.side), "channels": 1, "scene": f"`{row.scene}`",
            "target": row.value, "pictures": row.pictures, "patterns": row.patterns,
            "megabytes": row.stored_mb, "processing_s": row.processing_s,
        }  # fmt: skip


def _of_runs(table: Path) -> Iterator[dict[str, Any]]:
    """Yield the acquisitions of a run in `_RUNS`, RGB, after their last levels."""
    rows = pd.read_csv(table).groupby(["scene", "method"], sort=False).tail(1)
    for row in rows.itertuples():
        if (row.scene, row.method) in _RUNS:
            shape, target = _RUNS[row.scene, row.method]
            yield {
                "shape": shape, "channels": 3, "scene": f"`{row.scene}`", "target": target,
                "pictures": row.pictures, "patterns": row.patterns, "megabytes": row.megabytes,
            }  # fmt: skip


def _processing_seconds(stages: pd.DataFrame, row: dict[str, Any]) -> float:
    """Return the processor seconds of the stages of a run that process; NaN if unknown."""
    of_run = stages[(stages["scene"] == row["scene"].strip("`")) & (stages["method"] == AUTO)]
    names = ["schedule", "merge", "normalize", "refine", "assemble"]
    return (
        float(of_run[of_run["stage"].isin(names)]["processor_s"].sum()) if len(of_run) else math.nan
    )


def _minutes(pictures: float) -> str:
    return f"{SECONDS * pictures / 60:.1f}"
