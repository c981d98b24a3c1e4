"""Error against patterns of all methods, as ``benchmarks/bench_speed_error.py`` measured them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from rfpipe.report import methods
from rfpipe.report.blocks import Block, Column, Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import draw_method, scene_curves
from rfpipe.report.inputs import COLUMNS, PLACE, Inputs
from rfpipe.report.text import fixed, number, percent, size, words

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "ESTIMATE_FACTOR",
    "against_symmetric",
    "curves_figure",
    "patterns_at_error",
    "rivals_section",
    "summary_lines",
]

ESTIMATE_FACTOR = 1.5
"""How far off an estimated error may be, either way."""

_NOISE = {"default": "the default camera", "low_light": "a sixteenth of its light"}


def patterns_at_error(patterns: ArrayLike, errors: ArrayLike, wanted: float) -> float:
    """Return how many patterns a method needs for an error, between the runs that were made.

    Parameters
    ----------
    patterns, errors : array_like of float, shape (n,)
        Of a method's runs on one scene, n at least 1, above 0; in any order. A run that took more
        patterns for more error than another says nothing.
    wanted : float
        The error, above 0.

    Returns
    -------
    float
        Interpolated between logarithms. The fewest patterns of any run where that one's error is
        below `wanted` already; infinity where no run's error is as low.
    """
    order = np.lexsort((np.asarray(errors, float), np.asarray(patterns, float)))
    x, y = np.asarray(patterns, float)[order], np.asarray(errors, float)[order]
    best = np.concatenate([[True], y[1:] < np.minimum.accumulate(y)[:-1]])
    x, y = x[best], y[best]
    if wanted < y[-1]:
        return math.inf
    return float(np.exp(np.interp(-np.log(wanted), -np.log(y), np.log(x))))


def against_symmetric(table: pd.DataFrame) -> pd.DataFrame:
    """Set every near/far run beside symmetric photography of the same scene.

    Parameters
    ----------
    table : DataFrame
        With `rfpipe.report.inputs.COLUMNS`.

    Returns
    -------
    DataFrame
        A row for each run of near_far: scene, size, noise and seed; ``target_error``,
        ``patterns``, ``estimated_error``, ``error_mean``, ``error_worst``; ``estimate_ratio``:
        estimated over mean error; ``symmetric_for_mean``, ``symmetric_for_worst``: the patterns
        that symmetric photography needs for the same error, see `patterns_at_error`, NaN where it
        wasn't run; ``times_fewer_for_mean``, ``times_fewer_for_worst``.
    """
    import pandas as pd

    kept = ["patterns", "estimated_error", "error_mean", "error_worst"]
    symmetric = dict(list(table[table["method"] == methods.SYMMETRIC].groupby(list(PLACE))))
    rows = []
    for run in table[table["method"] == methods.NEAR_FAR].to_dict("records"):
        place = {name: run[name] for name in PLACE}
        row = {**place, "target_error": run["setting"], **{name: run[name] for name in kept}}
        row["estimate_ratio"] = run["estimated_error"] / (run["error_mean"] or math.nan)
        yardstick = symmetric.get(tuple(place.values()))
        for name in ("mean", "worst"):
            error, needed = f"error_{name}", math.nan
            if yardstick is not None:
                needed = patterns_at_error(yardstick["patterns"], yardstick[error], run[error])
            row[f"symmetric_for_{name}"] = needed
            row[f"times_fewer_for_{name}"] = needed / run["patterns"]
        rows.append(row)
    return pd.DataFrame(rows)


def summary_lines(beside: pd.DataFrame) -> list[str]:
    """Say in a few lines what `against_symmetric` found."""
    if beside.empty:
        return ["no run of near_far to compare"]
    estimates = beside["estimate_ratio"].dropna()
    within = estimates.between(1 / ESTIMATE_FACTOR, ESTIMATE_FACTOR).mean()
    lines = []
    if len(estimates):
        lines.append(
            f"estimated within a factor of {ESTIMATE_FACTOR:g} of the true mean error: "
            f"{within:.0%} of {len(estimates)} runs"
        )
    for name in ("mean", "worst"):
        times = beside[f"times_fewer_for_{name}"].dropna()
        if len(times):
            lines.append(
                f"times fewer patterns than symmetric photography for the same {name} error: "
                f"least {times.min():.1f}, median {times.median():.1f}, of {len(times)} runs; "
                f"not reached by it in {int(np.isinf(times).sum())}"
            )
    return lines


def rivals_section(inputs: Inputs) -> Section | None:
    """Error against patterns of all methods, or None where that wasn't measured."""
    table = inputs.benchmarks.get("speed_error")
    if table is None:
        return None
    blocks: list[Block] = []
    for _, rows in table.groupby(["noise", "height", "width"], sort=False):
        noise, height, width = rows[["noise", "height", "width"]].iloc[0]
        name = f"{size(height, width)}, {_NOISE.get(noise, noise)}"
        slug = f"rivals_{noise}_{height}x{width}"
        blocks.append(Illustration(name, _CURVES, slug, curves_figure(rows)))
    beside = against_symmetric(table)
    text = [_ABOUT]
    if len(beside):
        text += [". ".join(line[0].upper() + line[1:] for line in summary_lines(beside)) + "."]
        shown = _comparison_table(beside)
        blocks.append(Tabulation("Near/far against symmetric photography", _BESIDE, shown))
    blocks.append(Tabulation("Runs", _RUNS, _runs_table(table)))
    title, sources = "Error against patterns of all methods", ["bench/speed_error.csv"]
    return Section("rivals", title, blocks, text, sources)


_ABOUT = (
    "Measured by `benchmarks/bench_speed_error.py`, apart from the run above: each method at each "
    "of its settings through a simulated camera, its errors taken over the relighting patterns, "
    "the crease among them."
)
_CURVES = (
    "Relative RMS error against the patterns shown, both axes logarithmic: solid the mean over the "
    "relighting patterns, dotted the worst of them; each the geometric mean over the seeds."
)
_BESIDE = (
    "Every run of near/far acquisition; what it said of its own error, over its true mean error; "
    "and how many patterns symmetric photography takes for the same mean and the same worst error, "
    "between its own runs on the logarithmic curves above, and how many times as many that are. A "
    "dash: it was not run there, or reached no such error at any of its tolerances."
)
_RUNS = (
    "The setting is a tolerance, a target error or a number of patterns, as the method takes it. "
    "Means and geometric means over the seeds."
)


def curves_figure(table: pd.DataFrame) -> Figure:
    """Draw errors against patterns, a panel a scene.

    Parameters
    ----------
    table : DataFrame
        With `rfpipe.report.inputs.COLUMNS`, of one size and one camera.
    """

    def draw(axis: Axes, scene: str) -> None:
        for method, rows in table[table["scene"] == scene].groupby("method", sort=False):
            means = _over_seeds(rows, ["setting"]).sort_values("patterns")
            draw_method(axis, means["patterns"], 100 * means["error_mean"], str(method))
            axis.plot(means["patterns"], 100 * means["error_worst"], ".:", markersize=3,
                      linewidth=1, color=methods.colour(str(method)))  # fmt: skip

    titles = {scene: words(scene) for scene in table["scene"]}
    return scene_curves(titles, draw, table["patterns"], table[["error_mean", "error_worst"]])


def _over_seeds(table: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """Average the runs that differ in their seed alone: geometric means of errors."""
    errors = [name for name in COLUMNS if "error" in name or name.startswith("unlit")]
    plain = ["patterns", "processing_seconds", "transport_mb"]
    with np.errstate(divide="ignore"):  # a method that is exact on one pattern has no error there
        logarithms = table.assign(**{name: np.log(table[name]) for name in errors})
    means = logarithms.groupby(list(columns), sort=False)[plain + errors].mean()
    return means.assign(**{name: np.exp(means[name]) for name in errors}).reset_index()


_WHERE: list[Column] = [
    ("scene", "scene", words),
    ("size", "size", str),
    ("camera", "noise", words),
]


def _with_sizes(table: pd.DataFrame) -> pd.DataFrame:
    """Add to a table the size of each row as text."""
    return table.assign(size=[size(*both) for both in table[["height", "width"]].to_numpy(int)])


def _comparison_table(beside: pd.DataFrame) -> Table:
    return table_of(
        _with_sizes(beside),
        _WHERE,
        [
            ("seed", "seed", str),
            ("target, %", "target_error", percent),
            ("patterns", "patterns", number),
            ("mean", "error_mean", percent),
            ("worst", "error_worst", percent),
            ("over true", "estimate_ratio", fixed(2)),
            ("patterns", "symmetric_for_mean", number),
            ("times as many", "times_fewer_for_mean", fixed(1)),
            ("patterns", "symmetric_for_worst", number),
            ("times as many", "times_fewer_for_worst", fixed(1)),
        ],
        [("", 6), ("near/far: error, %", 2), ("estimated", 1), ("symmetric, same mean", 2),
         ("symmetric, same worst", 2)],
        csv="bench_near_far.csv",
        numbers=beside,
    )  # fmt: skip


def _runs_table(table: pd.DataFrame) -> Table:
    places = ["scene", "height", "width", "noise", "method", "setting"]
    return table_of(
        _with_sizes(_over_seeds(table, places)),
        [*_WHERE, ("method", "method", methods.title)],
        [
            ("setting", "setting", "{:g}".format),
            ("patterns", "patterns", number),
            ("estimated", "estimated_error", percent),
            ("mean", "error_mean", percent),
            ("worst", "error_worst", percent),
            ("mean", "unlit_mean", percent),
            ("worst", "unlit_worst", percent),
            ("processing, s", "processing_seconds", fixed(2)),
            ("MB", "transport_mb", fixed(2)),
        ],
        [("", 6), ("error, %", 3), ("unlit pixels, %", 2), ("", 2)],
        csv="bench_speed_error.csv",
        numbers=table,
    )
