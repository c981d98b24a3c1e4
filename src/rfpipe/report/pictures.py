"""Transport matrices and relit pictures side by side [thesis Figs. 2.1, 5.7, 5.9 and B.1]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report import methods
from rfpipe.report.drawing import (
    brighten_unlit,
    head,
    label_below,
    label_left,
    new_figure,
    new_panels,
    panel_ratio,
    show_image,
    show_panels,
    show_radiance,
)
from rfpipe.report.inputs import Run, Study
from rfpipe.report.text import TIMES, words
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms
from rfpipe.stages.evaluating.slices import NO_LEAF
from rfpipe.stages.relight import right_half

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "DECADES",
    "amplification",
    "captured_figure",
    "levels_figure",
    "matrices_figure",
    "methods_figure",
    "mosaic_figure",
]

DECADES = 7
"""Decades of the matrix' entries that are shown, from the largest of a scene down."""

_DIFFERENCE = 0.01
"""Ends of the difference's colours, as a fraction of the radiance shown as white."""

_PANEL = 2.2  # inches
_SMALL_PANEL = 2.05
_COLUMN = 2.25  # of the transport matrices
_EMPTY_COLOUR = "#d3e3f3"
_CAPTURED_ABREAST = 4
_BRIGHT = 0.7  # of white: where the dark half's brightest light is amplified to


def amplification(run: Run) -> float:
    """Return the round factor that makes the unlit half of [Fig. 5.9] well visible."""
    dark = right_half(run.settings.shape) == 0
    brightest = float(np.percentile(run.read("half_truth")[dark], 99))
    wanted = _BRIGHT * run.white / brightest if brightest > 0 else 1.0
    magnitude = 10.0 ** np.floor(np.log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * magnitude <= wanted) * magnitude)


def methods_figure(scenes: Sequence[Sequence[Run]]) -> Figure:
    """Compare methods by the light that the lit right half sends to the left one [Fig. 5.9].

    Parameters
    ----------
    scenes : sequence of sequences of Run
        For each scene with indirect light its runs. A method that some scenes weren't acquired
        with leaves its panel empty there.
    """
    shown = list(dict.fromkeys(run.method for runs in scenes for run in runs))
    columns = len(shown) + 1
    panel = _PANEL * (1.25 if columns < 4 else 1.1)
    shapes = [runs[0].image_shape for runs in scenes]
    figure, axes = new_panels(len(scenes), columns, shapes, panel, 0.52)
    for row, runs in zip(axes, scenes, strict=True):
        gain = amplification(runs[0])
        pattern = right_half(runs[0].settings.shape)
        truth = runs[0].read("half_truth")
        for axis, method in zip(row, shown, strict=False):
            run = next((run for run in runs if run.method == method), None)
            if run is None:
                axis.set_axis_off()
                continue
            relit = run.read("half_relit")
            show_radiance(axis, brighten_unlit(relit, pattern, gain), run.white)
            error = unlit_rms(relit, truth, pattern)
            label_below(axis, f"patterns {run.patterns:,}\nerror on the left half {error:.1%}")
        show_radiance(row[-1], brighten_unlit(truth, pattern, gain), runs[0].white)
        label_below(row[-1], f"left half {TIMES} {gain:g}")
        row[0].text(-0.06, 0.5, runs[0].title, rotation=90, ha="right", va="center", fontsize=8.5,
                    transform=row[0].transAxes)  # fmt: skip
    head(axes[0], [*map(methods.title, shown), "Ground truth"])
    return figure


def levels_figure(runs: Sequence[Run]) -> Figure:
    """Relight the vertical bar as if the acquisition had stopped at each level [Fig. 5.7].

    Parameters
    ----------
    runs : sequence of Run
        Of one scene, the methods that have levels. Those without patterns are left out.
    """
    per_row, shapes = 5, [runs[0].image_shape]
    n_levels = max(sum(row["patterns"] > 0 for row in run.facts["levels"]) for run in runs)
    rows_each = -(-(n_levels + 1) // per_row)
    figure, axes = new_panels(rows_each * len(runs), per_row, shapes, _SMALL_PANEL, 0.42)
    for index, run in enumerate(runs):
        own = axes[index * rows_each : (index + 1) * rows_each]
        label_left(own[0, 0], run.method_title)
        truth = run.read_shown("truth")[0]
        patterns, panels = 0, []
        for row, image in zip(run.facts["levels"], run.read_shown("levels_relit"), strict=True):
            if row["patterns"]:
                patterns += int(row["patterns"])
                below = f"patterns {patterns:,}, error {relative_rms(image, truth):.1%}"
                panels.append((f"level {row['level']}", image, below))
        show_panels(own.flat, [*panels, ("ground truth", truth, "")], run.white)
    return figure


def mosaic_figure(study: Study) -> Figure:
    """Show the sum of single-pixel images before and after normalization [Fig. B.1]."""
    chains = list(dict.fromkeys(row["chain"] for row in study.rows))
    modes = list(dict.fromkeys(row["normalization"] for row in study.rows))
    about = {(row["chain"], row["normalization"]): row for row in study.rows}
    shapes = [study.images.shape(f"floodlit_{chains[0]}")]
    figure, axes = new_panels(len(chains), len(modes) + 1, shapes, 2.4, 0.62)
    names = {
        "none": "sum of all images",
        "per_channel": "normalized per channel",
        "total_energy": "normalized by total energy",
    }
    for row, chain in zip(axes, chains, strict=True):
        floodlit = study.images.read(f"floodlit_{chain}")
        white = float(floodlit.max())
        show_radiance(row[0], floodlit, white)
        label_left(row[0], _CHAINS[chain])
        for axis, mode in zip(row[1:], modes, strict=True):
            show_radiance(axis, study.images.read(f"sum_{chain}_{mode}"), white)
            facts = about[chain, mode]
            label_below(
                axis, f"light {facts['energy']:.0%}, colour contrast {facts['colour_contrast']:.0%}"
            )
    head(axes[0], ["floodlit", *(names[mode] for mode in modes)])
    return figure


_CHAINS = {
    "linear": "whole bracket,\nlinear interpolation",
    "median": "one short exposure,\nmedian interpolation",
}


def captured_figure(run: Run) -> Figure:
    """Show the floodlit images and the relit ones."""
    floodlit, relit = run.read("floodlit_captured"), run.read("floodlit_relit")
    shown = {
        "floodlit, captured": run.read_shown("floodlit_captured"),
        "floodlit, relit": run.read_shown("floodlit_relit"),
        **dict(zip(run.facts["names"], run.read_shown("relit"), strict=True)),
    }
    rows = -(-len(shown) // _CAPTURED_ABREAST)
    figure, axes = new_panels(rows, _CAPTURED_ABREAST, [run.image_shape], _SMALL_PANEL, 0.42)
    panels = [(words(name), image, "") for name, image in shown.items()]
    show_panels(axes.flat, panels, run.white)
    label_below(axes.flat[1], f"difference {relative_rms(relit, floodlit):.1%}")
    label_left(axes.flat[0], f"patterns {run.patterns:,}")
    return figure


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
    size = (_COLUMN * len(runs) + 0.9, _COLUMN * sum(heights) + 0.32 * n_rows)
    figure, axes = new_figure(n_rows, len(runs), size, height_ratios=heights)
    for column, run in zip(axes.T, runs, strict=True):
        _draw_column(column, run, with_levels)
    head(axes[0], [run.title for run in runs])
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
    show_radiance(next(panels), run.read("albedo"), 1.0)
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
    difference = (relit - truth).mean(axis=-1) / run.white
    show_image(next(panels), difference, cmap="RdBu_r", vmin=-_DIFFERENCE, vmax=_DIFFERENCE)


def _errors(run: Run, relit: NDArray[Any], truth: NDArray[Any], pattern: NDArray[Any]) -> str:
    unlit = unlit_rms(relit, truth, pattern) if run.is_coaxial else np.nan
    total = f"error {relative_rms(relit, truth):.2%}"
    return total if np.isnan(unlit) else f"{total}, unlit {unlit:.1%}"


def _show_line(axis: Axes, entries: NDArray[Any], run: Run) -> None:
    """Show the entries of T between the rays of a line on a logarithmic scale of grey."""
    from matplotlib.colors import LogNorm

    top = float(run.read("line_truth").mean(axis=-1).max()) or 1.0
    floor = top * 10.0**-DECADES
    grey = np.maximum(entries.mean(axis=-1), floor)
    show_image(axis, grey, cmap="magma", norm=LogNorm(floor, top))


def _show_levels(axis: Axes, run: Run) -> None:
    """Show leaf levels: white the coarsest, black single rays, empty ones pale blue."""
    levels = run.read("line_levels")
    shown = np.ma.masked_equal(levels, NO_LEAF)
    axis.set_facecolor(_EMPTY_COLOUR)
    show_image(axis, shown, cmap="gray_r", vmin=0, vmax=_last_level(run))


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
    add(slice(-1, None), ScalarMappable(Normalize(-_DIFFERENCE * 100, _DIFFERENCE * 100), "RdBu_r"),
        "% of white", aspect=16)  # fmt: skip
