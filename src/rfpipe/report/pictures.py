"""Transport matrices and relit pictures side by side [thesis Figs. 2.1, 5.7 and 5.9]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.drawing import (
    ABREAST,
    UNLIT_GAIN,
    Drawn,
    Map,
    Panel,
    draw,
    unlit_gain,
    with_errors,
)
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.page import Block, Illustration, Section
from rfpipe.report.text import words
from rfpipe.stages.evaluate import relative_rms, unlit_rms
from rfpipe.stages.relight import NO_LEAF, right_half

DECADES = 7
"""Decades of the matrix' entries that are shown, from the largest of a scene down."""

_BRIGHT = 0.7  # of white: where the dark half's brightest light is amplified to


def methods_section(inputs: Inputs) -> Section | None:
    """Fig. 5.9, for scenes with indirect light acquired with several methods."""
    scenes = [inputs.of_scene(scene) for scene in inputs.scenes]
    scenes = [runs for runs in scenes if len(runs) > 1 and runs[0].has_indirect_light]
    if not scenes:
        return None
    blocks: list[Block] = []
    for runs in scenes:
        gain = amplification(runs[0])
        caption = (
            "The right half of the scene is lit. The left half shows indirect light alone, light "
            f"that came by way of another surface, {gain:g} times brighter; below each picture its "
            "relative RMS error on the left half, and the difference from the truth."
        )
        figure = draw(methods_rows(inputs, runs, gain))
        name, slug = f"Fig. 5.9, {runs[0].scene}", f"fig_5_9_{runs[0].scene}"
        blocks.append(Illustration(name, caption, slug, figure, is_folded=bool(blocks)))
    return Section("methods", "The methods side by side (Fig. 5.9)", blocks)


def methods_rows(inputs: Inputs, runs: Sequence[Run], gain: float) -> list[list[Drawn]]:
    """Return a scene's pictures under the lit right half by each method, and their errors."""
    pattern = right_half(runs[0].settings.shape)
    brightened = unlit_gain(pattern, gain)
    half = runs[0].read("half_truth")
    truth = runs[0].panel(half, "Ground truth", "", brightened)
    panels = []
    for run in runs:
        relit = run.read("half_relit")
        below = f"patterns {run.patterns:,}, error {unlit_rms(relit, half, pattern):.1%}"
        panels.append(run.panel(relit, inputs.title(run.method), below, brightened))
    return with_errors(panels, truth, len(runs) + 1)


def amplification(run: Run) -> float:
    """Return the round factor that makes the unlit half of [Fig. 5.9] well visible."""
    dark = right_half(run.settings.shape) == 0
    brightest = float(np.percentile(run.read("half_truth")[dark], 99))
    wanted = _BRIGHT * run.white / brightest if brightest > 0 else 1.0
    magnitude = 10.0 ** np.floor(np.log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * magnitude <= wanted) * magnitude)


def captured_section(inputs: Inputs) -> Section:
    """The scene under floodlight and under the relighting patterns, for each method."""
    caption = (
        "The scene under floodlight, as the rig captured it and as relit, with their relative RMS "
        "difference, and relit with each of the relighting patterns. The difference tells whether "
        "the levels add up, not whether each pixel's light comes from the right place."
    )
    return Section(
        "captured",
        "The scene relit",
        [
            Illustration(
                f"{run.scene}, {inputs.title(run.method).lower()}",
                caption,
                f"captured_{run.scene}_{run.method}",
                draw(captured_rows(run)),
            )
            for run in inputs.runs
        ],
    )


def captured_rows(run: Run) -> list[list[Panel]]:
    """Return the floodlit images and the relit ones, the middle view of several."""
    captured, relit = run.read("floodlit_captured"), run.read("floodlit_relit")
    difference = f"difference {relative_rms(relit, captured):.1%}"
    panels = [
        run.panel(run.middle(captured), "floodlit, captured", f"patterns {run.patterns:,}"),
        run.panel(run.middle(relit), "floodlit, relit", difference),
    ]
    images = run.middle(run.read("relit"))
    for name, image in zip(run.facts["names"], images, strict=True):
        panels.append(run.panel(image, words(name)))
    return [panels[first : first + ABREAST] for first in range(0, len(panels), ABREAST)]


def levels_section(inputs: Inputs) -> Section | None:
    """Fig. 5.7, for the last scene, with indirect light if there is one."""
    with_levels = [run for run in inputs.runs if run.knows_levels]
    if not with_levels:
        return None
    indirect = [run for run in with_levels if run.has_indirect_light]
    images = [run for run in with_levels if not run.settings.is_light_field]
    last = (indirect or images or with_levels)[-1]
    where = ", the middle view," if last.settings.is_light_field else ""
    caption = (
        f"{last.scene}{where} relit with the vertical bar, as if the acquisition had stopped at "
        "each level; patterns shown up to there, relative RMS error, and below the difference from "
        "the truth. Methods that fit all their pictures together tell nothing of earlier levels."
    )
    blocks = [
        Illustration(
            f"Fig. 5.7, {inputs.listed([run.method])}",
            caption,
            f"fig_5_7_{run.method}",
            draw(levels_rows(run)),
        )
        for run in with_levels
        if run.scene == last.scene
    ]
    return Section("levels", "Stopping at a level (Fig. 5.7)", blocks)


def levels_rows(run: Run) -> list[list[Drawn]]:
    """Return a run's picture at each level that showed patterns, and their errors."""
    truth = run.middle(run.read("truth")[0])
    patterns, panels = 0, []
    images = run.middle(run.read("levels_relit"))
    for row, image in zip(run.facts["levels"], images, strict=True):
        if row["patterns"]:
            patterns += int(row["patterns"])
            below = f"patterns {patterns:,}, error {relative_rms(image, truth):.1%}"
            panels.append(run.panel(image, f"level {row['level']}", below))
    return with_errors(panels, run.panel(truth, "ground truth"))


def matrices_section(inputs: Inputs) -> Section:
    """Fig. 2.1 for each method."""
    blocks: list[Block] = []
    for method in inputs.methods:
        images = [
            run for run in inputs.runs if run.method == method and not run.settings.is_light_field
        ]
        for first in range(0, len(images), ABREAST):
            runs = images[first : first + ABREAST]
            caption = (
                "T is the light transport matrix: how much light each projector ray, a column, "
                "sends into each camera ray, a row. (a) Albedo. (b) The scene under floodlight, "
                "rendered from the acquired T. (c) Entries of T between the rays of the image's "
                f"middle row, acquired and true: mean of the channels, over {DECADES} decades. On "
                "a coaxial rig the diagonal is direct light. "
                + "(d) Level of the leaf that holds each entry: pale blue none. "
                * all(run.has_leaf_levels for run in runs)
                + "(e) Relit with a vertical bar"
                + f", unlit pixels {UNLIT_GAIN} times brighter"
                * any(run.is_coaxial for run in runs)
                + "; below it the truth, and the difference."
            )
            blocks.append(
                Illustration(
                    f"Fig. 2.1, {inputs.listed([method])}",
                    caption,
                    f"fig_2_1_{method}" + f"_{first // ABREAST + 1}" * (len(images) > ABREAST),
                    matrices_figure(runs),
                    is_folded=method != inputs.methods[0],
                )
            )
    return Section("matrices", "The transport matrices (Fig. 2.1)", blocks)


def matrices_figure(runs: Sequence[Run]) -> Any:
    """Draw rows (a) to (e) of Fig. 2.1, a column for each run of one method."""
    with_levels = all(run.has_leaf_levels for run in runs)
    columns = [list(_matrix_panels(run, with_levels)) for run in runs]
    names = ["(a) albedo", "(b) T x floodlight", "(c) T along a row\ncamera ray", "true T"]
    names += ["(d) level of the leaf"] if with_levels else []
    rows = list(zip(*columns, strict=True))
    return draw(rows, left=[*names, "(e) T x vertical bar", "true radiance", ""])


def _matrix_panels(run: Run, with_levels: bool) -> Iterator[Panel | Map | Any]:
    """Yield one run's panels, top to bottom."""
    from matplotlib.colors import LogNorm

    yield Panel(run.read("albedo"), run.scene)
    floodlit = run.read("floodlit_relit")
    yield run.panel(floodlit, "", f"error {relative_rms(floodlit, run.read('floodlit_truth')):.2%}")
    top = float(run.read("line_truth").mean(axis=-1).max()) or 1.0
    for name in ("line_relit", "line_truth"):
        share = np.maximum(run.read(name).mean(axis=-1) / top, 10.0**-DECADES)
        grey = {"cmap": "magma", "norm": LogNorm(10.0**-DECADES, 1)}
        yield Map(share, "", "projector ray", "entry of T over the largest", grey)
    if with_levels:
        levels = np.ma.masked_equal(run.read("line_levels"), NO_LEAF)
        last = max((int(row["level"]) for row in run.facts["levels"]), default=0) or 1
        shades = {"cmap": "gray_r", "vmin": 0, "vmax": last}
        yield Map(levels, "", "projector ray", "level", shades)
    pattern, image, truth = (run.read(name)[0] for name in ("patterns", "relit", "truth"))
    gain = unlit_gain(pattern) if run.is_coaxial else 1.0
    relit = run.panel(image, "", _errors(run, image, truth, pattern), gain)
    true = run.panel(truth, "", "", gain)
    yield from (relit, true, relit.less(true))


def _errors(run: Run, relit: NDArray[Any], truth: NDArray[Any], pattern: NDArray[Any]) -> str:
    unlit = unlit_rms(relit, truth, pattern) if run.is_coaxial else np.nan
    total = f"error {relative_rms(relit, truth):.2%}"
    return total if np.isnan(unlit) else f"{total}, unlit {unlit:.1%}"
