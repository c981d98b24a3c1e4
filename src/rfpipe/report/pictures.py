"""Transport matrices and relit pictures side by side [thesis Figs. 2.1, 5.7, 5.9 and B.1]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report import methods
from rfpipe.report.blocks import Block, Illustration, Section
from rfpipe.report.drawing import (
    UNLIT_GAIN,
    Drawing,
    colour_bar,
    head,
    label_below,
    label_left,
    new_figure,
    new_panels,
    panel_ratio,
    parts,
    show_image,
    show_panels,
    unlit_gain,
)
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.light import Light
from rfpipe.report.text import TIMES, words
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms
from rfpipe.stages.relight import NO_LEAF, right_half

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DECADES = 7
"""Decades of the matrix' entries that are shown, from the largest of a scene down."""

_ERROR = "relit \N{MINUS SIGN} truth"
_PANEL = 2.2  # inches
_SMALL_PANEL = 2.05
_COLUMN = 2.25  # of the transport matrices
_EMPTY_COLOUR = "#d3e3f3"
_CAPTURED_ABREAST = 4
_BRIGHT = 0.7  # of white: where the dark half's brightest light is amplified to


def methods_section(inputs: Inputs) -> Section | None:
    """Fig. 5.9, for scenes with indirect light acquired with several methods."""
    scenes = [inputs.of_scene(scene) for scene in inputs.scenes]
    scenes = [runs for runs in scenes if len(runs) > 1 and runs[0].has_indirect_light]
    if not scenes:
        return None
    caption = (
        "The right half of each scene is lit. The left half shows indirect light alone, light "
        "that came by way of another surface, and is amplified by the factor given, the same in a "
        "row. Relative RMS error on the left half; below each picture its difference from the "
        "truth, amplified as the pictures are."
    )
    return Section(
        "methods",
        "The methods side by side (Fig. 5.9)",
        [
            Illustration(
                "Fig. 5.9",
                caption,
                f"fig_5_9{suffix}",
                methods_figure(part),
            )
            for part, suffix in parts(scenes)
        ],
    )


def captured_section(inputs: Inputs) -> Section:
    """The scene under floodlight and under the relighting patterns, for each method."""
    caption = (
        "The scene under floodlight, as the rig captured it and as relit from what was acquired, "
        "with their relative RMS difference, and the scene relit with each of the relighting "
        "patterns. The difference tells whether the levels add up, not whether each pixel's light "
        "comes from the right place."
    )
    if inputs.light_fields:
        caption += " Of the views the middle one is shown."
    return Section(
        "captured",
        "The scene relit",
        [
            Illustration(
                f"{run.title}, {run.method_title.lower()}",
                caption,
                f"captured_{run.scene}_{run.method}",
                captured_figure(run),
            )
            for run in inputs.runs
        ],
    )


def matrices_section(inputs: Inputs) -> Section:
    """Fig. 2.1 for each method."""
    blocks: list[Block] = []
    for method in inputs.methods:
        images = [run for run in inputs.of_method(method) if not run.settings.is_light_field]
        for runs, suffix in parts(images):
            leaves = (
                "(d) Level of the leaf that holds each entry: white the root, black single rays, "
                "pale blue empty. "
                if all(run.has_leaf_levels for run in runs)
                else ""
            )
            unlit = (
                f", unlit pixels {UNLIT_GAIN} times brighter"
                if any(run.is_coaxial for run in runs)
                else ""
            )
            caption = (
                "T is the light transport matrix: how much light each projector ray, a column, "
                "sends into each camera ray, a row. (a) Albedo of the scene. (b) The scene under "
                "floodlight, rendered from the acquired T; the line marks the rays of (c) and "
                "(d). (c) Entries of T between the rays of that line, camera rays down and "
                "projector rays across, acquired and true: mean of the channels, logarithmic over "
                f"{DECADES} decades. On a coaxial rig the diagonal is direct light, the "
                "off-diagonal quarters light from one plane to the other, the diagonal quarters "
                f"third bounces. {leaves}(e) Relit with a vertical bar{unlit}; below it the truth, "
                "and relit minus true as it shows here."
            )
            blocks.append(
                Illustration(
                    f"Fig. 2.1, {methods.listed([method])}",
                    caption,
                    f"fig_2_1_{method}{suffix}",
                    matrices_figure(runs),
                    is_folded=method != inputs.methods[0],
                )
            )
    return Section("matrices", "The transport matrices (Fig. 2.1)", blocks)


def levels_section(inputs: Inputs) -> Section | None:
    """Fig. 5.7, for the last scene, with indirect light if there is one."""
    with_levels = [run for run in inputs.runs if run.knows_levels]
    if not with_levels:
        return None
    indirect = [run for run in with_levels if run.has_indirect_light]
    images = [run for run in with_levels if not run.settings.is_light_field]
    last = (indirect or images or with_levels)[-1]
    runs = [run for run in with_levels if run.scene == last.scene]
    where = ", the middle view," if last.settings.is_light_field else ""
    caption = (
        f"{last.title}{where} relit with the vertical bar, as if the acquisition had stopped at "
        "each level of its subdivision into smaller blocks; patterns shown up to there, the "
        "relative RMS error in total, and below the difference from the truth. Where blocks are "
        "stored as products of two images, a picture has full resolution at every level, but the "
        "light of a lit pixel is spread over its whole block. Methods that fit all their pictures "
        "together are left out: they don't tell what they knew at an earlier level."
    )
    figure = Illustration("Fig. 5.7", caption, "fig_5_7", levels_figure(runs))
    return Section("levels", "Stopping at a level (Fig. 5.7)", [figure])


def amplification(run: Run) -> float:
    """Return the round factor that makes the unlit half of [Fig. 5.9] well visible."""
    dark = right_half(run.settings.shape) == 0
    brightest = float(np.percentile(run.read("half_truth")[dark], 99))
    wanted = _BRIGHT * run.white / brightest if brightest > 0 else 1.0
    magnitude = 10.0 ** np.floor(np.log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * magnitude <= wanted) * magnitude)


def methods_figure(scenes: Sequence[Sequence[Run]]) -> Drawing:
    """Compare methods by the light that the lit right half sends to the left one [Fig. 5.9].

    Parameters
    ----------
    scenes : sequence of sequences of Run
        For each scene with indirect light its runs. A method that some scenes weren't acquired
        with leaves its panels empty there.
    """
    shown = list(dict.fromkeys(run.method for runs in scenes for run in runs))
    columns = len(shown) + 1
    panel = _PANEL * (1.25 if columns < 4 else 1.1)
    shapes = [runs[0].image_shape for runs in scenes]
    drawing = new_panels(2 * len(scenes), columns, shapes, panel, 0.3)
    for pair, runs in zip(drawing.axes.reshape(-1, 2, columns), scenes, strict=True):
        _compare_methods(drawing, pair, shown, runs)
    head(drawing.axes[0], [*map(methods.title, shown), "Ground truth"])
    drawing.show_errors()
    return drawing


def _compare_methods(
    drawing: Drawing, rows: NDArray[Any], shown: Sequence[str], runs: Sequence[Run]
) -> None:
    """Draw a scene's pictures by method, and below each its error."""
    gain = amplification(runs[0])
    pattern = right_half(runs[0].settings.shape)
    brightened = unlit_gain(pattern, gain)
    truth = runs[0].light("ground truth", runs[0].read("half_truth"), brightened)
    of_method = {run.method: run for run in runs}
    for (upper, lower), method in zip(rows.T, shown, strict=False):
        run = of_method.get(method)
        if run is None:
            upper.set_axis_off()
            lower.set_axis_off()
            continue
        relit = run.light(run.method_title, run.read("half_relit"), brightened)
        error = unlit_rms(relit.radiance, truth.radiance, pattern)
        below = f"patterns {run.patterns:,}\nerror on the left half {error:.1%}"
        drawing.show(upper, relit, below)
        drawing.compare(lower, relit, truth)
    drawing.show(rows[0, -1], truth, f"left half {TIMES} {gain:g}")
    rows[1, -1].set_axis_off()
    label_left(rows[0, 0], runs[0].title)
    label_left(rows[1, 0], _ERROR)


def levels_figure(runs: Sequence[Run]) -> Drawing:
    """Relight the vertical bar as if the acquisition had stopped at each level [Fig. 5.7].

    Parameters
    ----------
    runs : sequence of Run
        Of one scene, the methods that have levels. Levels without patterns are left out.
    """
    per_row, shapes = 5, [runs[0].image_shape]
    truths = [run.light("ground truth", run.read_shown("truth")[0]) for run in runs]
    relit = [_levels_relit(run, truth) for run, truth in zip(runs, truths, strict=True)]
    n_rows = [2 * -(-(len(steps) + 1) // per_row) for steps in relit]
    drawing = new_panels(sum(n_rows), per_row, shapes, _SMALL_PANEL, 0.28)
    parts = np.split(drawing.axes, np.cumsum(n_rows)[:-1])
    for run, truth, steps, own in zip(runs, truths, relit, parts, strict=True):
        show_panels(drawing, own[::2].flat, [*steps, ("ground truth", truth, "")])
        free = iter(own[1::2].flat)
        for (_, light, _), axis in zip(steps, free, strict=False):
            drawing.compare(axis, light, truth)
        for axis in free:
            axis.set_axis_off()
        drawing.show_errors()
        label_left(own[0, 0], run.method_title)
        label_left(own[1, 0], _ERROR)
    return drawing


def _levels_relit(run: Run, truth: Light) -> list[tuple[str, Light, str]]:
    """Return a run's picture at each level that showed patterns: its title, and its error."""
    patterns, panels = 0, []
    for row, image in zip(run.facts["levels"], run.read_shown("levels_relit"), strict=True):
        if row["patterns"]:
            patterns += int(row["patterns"])
            title = f"level {row['level']}"
            below = f"patterns {patterns:,}, error {relative_rms(image, truth.radiance):.1%}"
            panels.append((title, run.light(f"{run.method_title}, {title}", image), below))
    return panels


def captured_figure(run: Run) -> Drawing:
    """Show the floodlit images and the relit ones."""
    floodlit, relit = run.read("floodlit_captured"), run.read("floodlit_relit")
    shown = {
        "floodlit, captured": run.read_shown("floodlit_captured"),
        "floodlit, relit": run.read_shown("floodlit_relit"),
        **dict(zip(run.facts["names"], run.read_shown("relit"), strict=True)),
    }
    difference = f"difference {relative_rms(relit, floodlit):.1%}"
    below = {**dict.fromkeys(shown, ""), "floodlit, relit": difference}
    rows = -(-len(shown) // _CAPTURED_ABREAST)
    drawing = new_panels(rows, _CAPTURED_ABREAST, [run.image_shape], _SMALL_PANEL, 0.42)
    panels = [
        (words(name), run.light(words(name), image), below[name]) for name, image in shown.items()
    ]
    show_panels(drawing, drawing.axes.flat, panels)
    label_left(drawing.axes.flat[0], f"patterns {run.patterns:,}")
    return drawing


def matrices_figure(runs: Sequence[Run]) -> Drawing:
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
    drawing = Drawing(*new_figure(n_rows, len(runs), size, height_ratios=heights))
    for column, run in zip(drawing.axes.T, runs, strict=True):
        _draw_column(drawing, column, run, with_levels)
    head(drawing.axes[0], [run.title for run in runs])
    names = [
        "(a)  albedo",
        f"(b)  T {TIMES} floodlight",
        "(c)  T along the line\ncamera ray",
        "true T\ncamera ray",
    ]
    names += ["(d)  level of the leaf\ncamera ray"] if with_levels else []
    names += [f"(e)  T {TIMES} vertical bar", "true radiance", _ERROR]
    for axis, name in zip(drawing.axes[:, 0], names, strict=True):
        label_left(axis, name)
    _add_scales(drawing, runs, with_levels)
    drawing.show_errors()
    return drawing


def _draw_column(drawing: Drawing, column: NDArray[Any], run: Run, with_levels: bool) -> None:
    """Draw one run's panels, top to bottom."""
    panels = iter(column)
    albedo = Light(run.title, "albedo", run.read("albedo"), 1.0, quantity="albedo")
    drawing.show(next(panels), albedo)
    axis, floodlit = next(panels), run.read("floodlit_relit")
    error = relative_rms(floodlit, run.read("floodlit_truth"))
    drawing.show(axis, run.light("floodlit, relit", floodlit), f"error {error:.2%}")
    axis.axhline(run.facts["row"], color="#ffd84a", linewidth=1.6, alpha=0.55)
    for name in ("line_relit", "line_truth"):
        axis = next(panels)
        _show_line(axis, run.read(name), run)
        label_below(axis, "projector ray")
    if with_levels:
        axis = next(panels)
        _show_levels(axis, run)
        label_below(axis, "projector ray")
    pattern, relit, truth = (run.read(name)[0] for name in ("patterns", "relit", "truth"))
    gain = unlit_gain(pattern) if run.is_coaxial else 1.0
    ours = run.light("vertical bar, relit", relit, gain)
    true = run.light("vertical bar, truth", truth, gain)
    drawing.show(next(panels), ours, _errors(run, relit, truth, pattern))
    drawing.show(next(panels), true)
    drawing.compare(next(panels), ours, true)


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


def _add_scales(drawing: Drawing, runs: Sequence[Run], with_levels: bool) -> None:
    """Add colour bars at the right of the rows of matrices."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    last = list(drawing.axes[:, -1])
    entries = ScalarMappable(LogNorm(10.0**-DECADES, 1), "magma")
    colour_bar(drawing.figure, entries, last[2:4], "entry of T over the largest", aspect=32)
    if with_levels:
        deepest = max(_last_level(run) for run in runs)
        levels = ScalarMappable(Normalize(0, deepest), "gray_r")
        label, ticks = "level (pale blue: empty)", list(range(deepest + 1))
        colour_bar(drawing.figure, levels, last[4:5], label, aspect=16, ticks=ticks)
