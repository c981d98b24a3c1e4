"""The structure of the transport matrices [thesis Fig. 2.1]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.drawing import (
    brighten_unlit,
    label_below,
    label_left,
    new_figure,
    panel_ratio,
    show_radiance,
)
from rfpipe.report.inputs import Run
from rfpipe.report.text import TIMES
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms
from rfpipe.stages.evaluating.slices import NO_LEAF

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["DECADES", "DIFFERENCE", "matrices_figure"]

DECADES = 7
"""Decades of the matrix' entries that are shown, from the largest of a scene down."""

DIFFERENCE = 0.01
"""Ends of the difference's colours, as a fraction of the radiance shown as white."""

_PANEL = 2.25  # inches
_EMPTY_COLOUR = "#d3e3f3"


def matrices_figure(runs: Sequence[Run]) -> Figure:
    """Draw rows (a) to (e) of Fig. 2.1, a column for each run.

    Parameters
    ----------
    runs : sequence of Run
        Of one method, four at most to stay legible.
    """
    with_levels = all(run.has_leaf_levels for run in runs)
    n_rows = 8 if with_levels else 7
    ratio = panel_ratio([run.image_shape for run in runs])
    heights = [ratio] * 2 + [1.0] * (n_rows - 5) + [ratio] * 3
    size = (_PANEL * len(runs) + 0.9, _PANEL * sum(heights) + 0.32 * n_rows)
    figure, axes = new_figure(n_rows, len(runs), size, height_ratios=heights)
    for column, run in zip(axes.T, runs, strict=True):
        _draw_column(column, run, with_levels)
    names = ["(a)  albedo", f"(b)  T {TIMES} floodlight", "(c)  T along the line", "true T"]
    names += ["(d)  level of the leaf"] if with_levels else []
    names += [f"(e)  T {TIMES} vertical bar", "true radiance", "difference"]
    for axis, name in zip(axes[:, 0], names, strict=True):
        label_left(axis, name)
    _add_scales(figure, axes, runs, with_levels)
    return figure


def _draw_column(column: NDArray[Any], run: Run, with_levels: bool) -> None:
    """Draw one run's panels, top to bottom."""
    panels = iter(column)
    axis = next(panels)
    axis.set_title(run.title, fontsize=9.5, pad=5)
    show_radiance(axis, run.read("albedo"), 1.0)
    axis = next(panels)
    show_radiance(axis, run.read("floodlit_relit"), run.white)
    axis.axhline(run.facts["row"], color="#ffd84a", linewidth=1.6, alpha=0.55)
    error = relative_rms(run.read("floodlit_relit"), run.read("floodlit_truth"))
    label_below(axis, f"error {error:.2%}")
    for name in ("line_relit", "line_truth"):
        _show_line(next(panels), run.read(name), run)
    if with_levels:
        _show_levels(next(panels), run)
    pattern, relit, truth = (run.read(name)[0] for name in ("patterns", "relit", "truth"))
    axis = next(panels)
    label_below(axis, _errors(run, relit, truth, pattern))
    for panel, image in ((axis, relit), (next(panels), truth)):
        show_radiance(panel, brighten_unlit(image, pattern) if run.is_coaxial else image, run.white)
    axis = next(panels)
    difference = (relit - truth).mean(axis=-1) / run.white
    axis.imshow(difference, cmap="RdBu_r", vmin=-DIFFERENCE, vmax=DIFFERENCE,
                interpolation="nearest")  # fmt: skip
    axis.set_xticks([])
    axis.set_yticks([])


def _errors(run: Run, relit: NDArray[Any], truth: NDArray[Any], pattern: NDArray[Any]) -> str:
    unlit = unlit_rms(relit, truth, pattern) if run.is_coaxial else np.nan
    total = f"error {relative_rms(relit, truth):.2%}"
    return total if np.isnan(unlit) else f"{total}, unlit {unlit:.1%}"


def _top(run: Run) -> float:
    """Return the largest true entry along the line, over the channels' mean."""
    return float(run.read("line_truth").mean(axis=-1).max()) or 1.0


def _show_line(axis: Axes, entries: NDArray[Any], run: Run) -> None:
    """Show the entries of T between the rays of a line on a logarithmic scale of grey."""
    from matplotlib.colors import LogNorm

    top = _top(run)
    floor = top * 10.0**-DECADES
    grey = np.maximum(entries.mean(axis=-1), floor)
    axis.imshow(grey, cmap="magma", norm=LogNorm(floor, top), interpolation="nearest")
    axis.set_xticks([])
    axis.set_yticks([])


def _show_levels(axis: Axes, run: Run) -> None:
    """Show leaf levels: white the coarsest, black single rays, empty ones pale blue."""
    levels = run.read("line_levels")
    shown = np.ma.masked_equal(levels, NO_LEAF)
    axis.set_facecolor(_EMPTY_COLOUR)
    axis.imshow(shown, cmap="gray_r", vmin=0, vmax=_last_level(run), interpolation="nearest")
    axis.set_xticks([])
    axis.set_yticks([])


def _last_level(run: Run) -> int:
    return max((int(row["level"]) for row in run.facts["levels"]), default=0) or 1


def _add_scales(figure: Figure, axes: NDArray[Any], runs: Sequence[Run], with_levels: bool) -> None:
    """Add colour bars at the right of the rows that need one."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    def add(rows: slice, mappable: ScalarMappable, label: str, **options: Any) -> None:
        bar = figure.colorbar(mappable, ax=list(axes[rows, -1]), fraction=0.06, pad=0.03, **options)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7.5, width=0.5, length=2.5)
        bar.outline.set_linewidth(0.5)

    add(slice(2, 4), ScalarMappable(LogNorm(10.0**-DECADES, 1), "magma"),
        "entry of T over the largest", aspect=32)  # fmt: skip
    if with_levels:
        deepest = max(_last_level(run) for run in runs)
        add(slice(4, 5), ScalarMappable(Normalize(0, deepest), "gray_r"),
            "level (pale blue: empty)", aspect=16, ticks=list(range(deepest + 1)))  # fmt: skip
    add(slice(-1, None), ScalarMappable(Normalize(-DIFFERENCE * 100, DIFFERENCE * 100), "RdBu_r"),
        "% of white", aspect=16)  # fmt: skip
