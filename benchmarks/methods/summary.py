"""The table of acquisitions summed up, and where methods fail."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from benchmarks.methods.cases import method_of

__all__ = ["OPEN", "failures", "sections", "summary_of", "tightest"]

OPEN, HELD_OUT = "open", "held out"

_ROSE = 1.1  # errors along a method's settings that rise by more than noise does
_OFF = 2.0  # an estimate this many times the truth, or less than its inverse

_GROUP = ["section", "what", "scene", "side", "light", "method", "option", "value"]


def sections(table: pd.DataFrame) -> pd.Series[str]:
    """Return "held out" for the rows of scenes or seeds that are, else "open"."""
    held = table["held_out_scene"].astype(bool) | table["held_out_seed"].astype(bool)
    return held.map({False: OPEN, True: HELD_OUT})


def summary_of(table: pd.DataFrame) -> pd.DataFrame:
    """Sum up the acquisitions: a row a scene, light, method and setting, over its seeds.

    Parameters
    ----------
    table : DataFrame
        See `benchmarks.methods.rows.newest`.

    Returns
    -------
    DataFrame
        What it is grouped by; how many runs there were, and how many ended; means of patterns,
        costs, errors and estimates, the worst of the worst errors; estimate over truth, the
        geometric mean; why a run didn't end.
    """
    grouped = table.assign(
        section=sections(table),
        ended=table["status"] == "done",
        ratio=np.log(table["estimated_error"] / table["error_mean"]),
    ).groupby(_GROUP, sort=False)
    means = ["patterns", "brackets", "exposure_s", "light_s", "error_mean", "unlit_mean",
             "photo_mean", "photo_unlit", "grain", "estimated_error", "patterns_by_estimate",
             "processing_s", "stored_mb"]  # fmt: skip
    found = grouped.agg(
        runs=("ended", "size"),
        ended=("ended", "sum"),
        camera_rays=("camera_rays", "max"),
        projector_rays=("projector_rays", "max"),
        **{name: (name, "mean") for name in means},
        error_worst=("error_worst", "max"),
        unlit_worst=("unlit_worst", "max"),
        ratio=("ratio", "mean"),
        why=("why", "first"),
    )
    found["ratio"] = np.exp(found["ratio"])
    return found.reset_index()


def tightest(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the row of each scene, light and method with the tightest setting that ended."""
    ended = summary[summary["ended"] > 0]
    order = ended.assign(
        rank=[_rank(*each) for each in zip(ended["method"], ended["value"], strict=True)]
    )
    last = order.sort_values("rank", kind="stable").drop_duplicates(
        ["section", "scene", "side", "light", "method"], keep="last"
    )
    return last.drop(columns="rank").sort_index()


def _rank(method: str, value: float) -> int:
    """Place of a setting among a method's trials, from the coarsest."""
    trials = method_of(method).trials
    return trials.index(value) if value in trials else 0


def failures(summary: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Yield what went wrong, by rule: section, method, scene, light, and what happened.

    A run refused or failed; an error that rises by a tenth as the setting gets tighter; a target
    that was missed; an estimate that is off by a factor of two.
    """
    by = ["section", "method", "scene", "light"]
    for key, rows in summary.groupby(by, sort=False):
        place = dict(zip(by, key, strict=True))
        method = method_of(place["method"])
        for why in dict.fromkeys(rows["why"][rows["ended"] == 0]):
            yield {**place, "kind": "refused", "what": why}
        done = rows[rows["ended"] > 0].to_dict("records")
        done.sort(key=lambda row: _rank(row["method"], row["value"]))
        for coarse, fine in pairwise(done):
            if fine["error_mean"] > _ROSE * coarse["error_mean"]:
                what = (
                    f"{_per_cent(coarse['error_mean'])} at {coarse['value']:g}, "
                    f"{_per_cent(fine['error_mean'])} at {fine['value']:g}"
                )
                yield {**place, "kind": "rises", "what": what}
        for row in done:
            asked = f"{row['option']} {row['value']:g}"
            if method.trades == "target_error" and row["error_mean"] > row["value"]:
                what = f"{asked}: {_per_cent(row['error_mean'])} in {row['patterns']:.0f} patterns"
                yield {**place, "kind": "target missed", "what": what}
            if row["ratio"] > _OFF or row["ratio"] < 1 / _OFF:
                estimated, true = row["estimated_error"], row["error_mean"]
                what = f"{asked}: estimated {_per_cent(estimated)}, is {_per_cent(true)}"
                yield {**place, "kind": "estimate off", "what": what}


def _per_cent(fraction: float) -> str:
    return f"{100 * fraction:.3g} %"
