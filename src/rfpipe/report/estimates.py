"""What methods said of their own error while they ran, beside the error that they had."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rfpipe.report import methods
from rfpipe.report.blocks import Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import draw_method, scene_curves
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import fixed, number, percent
from rfpipe.transport.base import HISTORY_COLUMNS, estimates

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["compare", "estimates_figure", "estimates_section", "histories"]


def estimates_section(inputs: Inputs) -> Section | None:
    """Estimated error against patterns, or None where no method estimated its own."""
    steps = histories(inputs.runs)
    if steps.empty:
        return None
    compared = compare(inputs)
    target = compared["target_error"].min()
    curve = (
        "The error that a method estimated against the patterns shown until then, both axes "
        f"logarithmic. Dotted: the error asked for, {target:.3g} of a relit image's norm. An "
        "estimate that is all noise, 0, stands in the table alone."
    )
    beside = (
        "The last estimate, the mean relative RMS error over the relighting patterns, and the one "
        "over the other."
    )
    if compared["true_error"].notna().any():
        curve += " Dashed: the mean error over the relighting patterns at the end."
    else:
        beside += " The truth is not known here."
    titles = {run.scene: run.title for run in inputs.runs}
    figure = estimates_figure(steps, compared, target, titles)
    return Section(
        "estimates",
        "Estimated error while it ran",
        [
            Illustration("Estimated error against patterns", curve, "estimated_error", figure),
            Tabulation("Estimated and true error", beside, _compared(compared, inputs)),
            Tabulation("Estimates level by level", _STEPS, _stepwise(steps, inputs)),
        ],
        [_ABOUT],
    )


_ABOUT = (
    "These methods judge their own transport by pictures of patterns that it was not made from, "
    "the camera's noise taken off, and stop at the error asked for. Near/far acquisition keeps "
    "patterns aside for that; optical low rank tests each round's pictures on the fit before the "
    "round, so that its estimate is an older, worse transport's."
)
_STEPS = "Patterns shown up to each level and the error estimated after it."


def histories(runs: Sequence[Run]) -> pd.DataFrame:
    """Return the estimates of all runs: ``scene``, ``method`` and `HISTORY_COLUMNS`."""
    import pandas as pd

    rows = [
        {"scene": run.scene, "method": run.method, **step}
        for run in runs
        for step in estimates(run.facts["levels"])
    ]
    return pd.DataFrame(rows, columns=["scene", "method", *HISTORY_COLUMNS])


def compare(inputs: Inputs) -> pd.DataFrame:
    """Set each run's last estimate beside its true error.

    Returns
    -------
    DataFrame
        For each run that estimated its error ``scene``, ``method``, ``patterns`` of the whole run,
        ``target_error``, ``estimated_error``, ``true_error``: the mean total error over the
        relighting patterns, and ``ratio`` of estimate to truth; the last two NaN where the truth
        is not known, the ratio also where the error is 0.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for run in inputs.runs:
        found = estimates(run.facts["levels"])
        if not found:
            continue
        own = run.own(inputs.errors)
        true = float(own["rms_total"].mean()) if len(own) else math.nan
        estimated = found[-1]["estimated_error"]
        rows.append(
            {
                "scene": run.scene,
                "method": run.method,
                "patterns": run.patterns,
                "target_error": run.facts["options"].get("target_error", math.nan),
                "estimated_error": estimated,
                "true_error": true,
                "ratio": estimated / (true or math.nan),
            }
        )
    return pd.DataFrame(rows)


def estimates_figure(
    steps: pd.DataFrame, compared: pd.DataFrame, target: float, titles: dict[str, str]
) -> Figure:
    """Draw estimates against patterns, a panel a scene.

    Parameters
    ----------
    steps, compared : DataFrame
        As `histories` and `compare` return them, not empty.
    target : float
        The error asked for.
    titles : dict of str to str
        Of the scenes.
    """

    def draw(axis: Axes, scene: str) -> None:
        for method, own in steps[steps["scene"] == scene].groupby("method", sort=False):
            seen = own[own["estimated_error"] > 0]
            draw_method(axis, seen["patterns"], 100 * seen["estimated_error"], str(method))
        known = compared[compared["scene"] == scene].dropna(subset=["true_error"])
        for run in known.to_dict("records"):
            colour = methods.colour(run["method"])
            axis.axhline(100 * run["true_error"], linestyle="--", linewidth=1.1, color=colour)
        axis.axhline(100 * target, linestyle=":", linewidth=0.9, color="#5c5c5c")

    errors = [*steps["estimated_error"], *compared["true_error"], target]
    shown = {scene: titles[scene] for scene in steps["scene"]}
    return scene_curves(shown, draw, steps["patterns"], errors, (1, 2, 5))


def _compared(compared: pd.DataFrame, inputs: Inputs) -> Table:
    return table_of(
        compared,
        inputs.labels,
        [
            ("patterns", "patterns", number),
            ("asked for", "target_error", percent),
            ("estimated", "estimated_error", percent),
            ("true", "true_error", percent),
            ("estimated over true", "ratio", fixed(2)),
        ],
        [("", 3), ("error, %", 3), ("", 1)],
        csv="estimates.csv",
    )


def _stepwise(steps: pd.DataFrame, inputs: Inputs) -> Table:
    return table_of(
        steps,
        inputs.labels,
        [
            ("level", "level", number),
            ("patterns", "patterns", number),
            ("estimated error, %", "estimated_error", percent),
        ],
        csv="estimate_history.csv",
    )
