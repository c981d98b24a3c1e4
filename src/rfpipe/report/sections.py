"""The sections on the acquired scenes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rfpipe.report import charts, methods, pictures, tables
from rfpipe.report.blocks import Block, Illustration, Section, Tabulation
from rfpipe.report.drawing import UNLIT_GAIN, chunks
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import number, percent, wishes, words

__all__ = [
    "captured_section",
    "cost_section",
    "errors_section",
    "leaves_section",
    "levels_section",
    "matrices_section",
    "methods_section",
    "speed_section",
]

_ABREAST = 4
"""Scenes side by side in a figure."""


def errors_section(inputs: Inputs) -> Section:
    """The errors of each run under each relighting pattern."""
    about = (
        f"Asked for were {wishes(inputs.config)}. Errors are relative RMS against the scene's "
        "exact light transport: in total, and on the pixels that the pattern leaves dark, which "
        "show indirect light alone."
    )
    detail = (
        "Relighting patterns: bars, noise, a binary picture, a small spot, and the crease, a strip "
        "along which surfaces meet, where there is one. Noise lights every pixel, so that none is "
        "unlit; a scene without indirect light has nothing to compare there either."
    )
    if not all(run.is_coaxial for run in inputs.runs):
        detail += " Nor is any pixel known to be unlit that a camera sees from aside."
    if inputs.light_fields:
        detail += (
            " In a light field each view's projector shows the pattern. Surfaces behind its unlit "
            "pixels may be lit from other views; one view lights the first view's pixels alone, so "
            "that the unlit ones are those of all other views."
        )
    return Section(
        "errors",
        "Errors by pattern",
        [Tabulation("Errors by pattern", detail, tables.errors_by_pattern(inputs))],
        [about],
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
                pictures.captured_figure(run),
            )
            for run in inputs.runs
        ],
    )


def matrices_section(inputs: Inputs) -> Section:
    """Fig. 2.1 for each method."""
    blocks: list[Block] = []
    for method in inputs.methods:
        images = [run for run in inputs.of_method(method) if not run.settings.is_light_field]
        for runs, suffix in _parts(images):
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
                f"{pictures.DECADES} decades. On a coaxial rig the diagonal is direct light, the "
                "off-diagonal quarters light from one plane to the other, the diagonal quarters "
                f"third bounces. {leaves}(e) Relit with a vertical bar{unlit}; below it the truth, "
                "and relit minus true as it shows here."
            )
            blocks.append(
                Illustration(
                    f"Fig. 2.1, {methods.listed([method])}",
                    caption,
                    f"fig_2_1_{method}{suffix}",
                    pictures.matrices_figure(runs),
                    is_folded=method != inputs.methods[0],
                )
            )
    return Section("matrices", "The transport matrices (Fig. 2.1)", blocks)


def _parts(items: Sequence[Any]) -> Iterator[tuple[Sequence[Any], str]]:
    """Cut what stands abreast into figures; yield the items of each and what tells its file."""
    parts = chunks(items, _ABREAST)
    for index, part in enumerate(parts):
        yield part, f"_{index + 1}" if len(parts) > 1 else ""


def cost_section(inputs: Inputs) -> Section:
    """Size, time and patterns, as Tables 3.1 and 5.1 have them."""
    per_pattern = inputs.config.capture.seconds_per_pattern
    caption = (
        f"Time is capture at {per_pattern:g} s a pattern plus the processing measured here"
        f"{inputs.without_references}; size is bytes on disk, compressed, 1 MB = 10⁶ bytes. "
        "Brute force is computed: one pattern a ray, T as float32."
    )
    block = Tabulation("Costs", caption, tables.cost_table(inputs), is_folded=False)
    title = "Size, time and patterns (Tables 3.1 and 5.1)"
    return Section("cost", title, [block])


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
                pictures.methods_figure(part),
            )
            for part, suffix in _parts(scenes)
        ],
    )


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
    figure = Illustration("Fig. 5.7", caption, "fig_5_7", pictures.levels_figure(runs))
    return Section("levels", "Stopping at a level (Fig. 5.7)", [figure])


def leaves_section(inputs: Inputs) -> Section | None:
    """Fig. 5.10."""
    runs = [run for run in inputs.runs if len(run.facts["levels"]) > 1]
    if not runs:
        return None
    drawn = [run for run in runs if charts.has_leaves_of_nodes(run)]
    groups = [
        [run for run in drawn if run.method == method and run.settings.is_light_field == is_field]
        for method in inputs.methods
        for is_field in (False, True)
    ]
    rows = [part for own in groups for part, _ in _parts(own)]
    caption = (
        "What becomes of the parts of T that are measured at each level, its nodes, in per cent "
        "of them: a leaf is stored as it is, the others are subdivided. With "
        "symmetric photography a node is a pair of blocks; empty ones are the sparse part of T, "
        "rank-1 ones the data-sparse part. With dual photography a node is a block as seen by one "
        "camera pixel, and a leaf a response that is stored at this level. The last level's "
        "leaves are scalars."
    )
    name = "Fig. 5.10" if inputs.has_truth else "Leaves"
    about = "Patterns and nodes of each level, added over the scenes of a method."
    blocks: list[Block] = [Tabulation("Levels", about, tables.levels_table(inputs))]
    if rows:
        figure = charts.leaves_figure(rows)
        blocks.insert(0, Illustration(name, caption, "fig_5_10", figure))
    title = "Leaves at each level (Fig. 5.10)" if inputs.has_truth else "Leaves at each level"
    return Section("leaves", title, blocks)


def speed_section(inputs: Inputs) -> Section | None:
    """Speed against error."""
    if not len(inputs.speed_error):
        return None
    caption = (
        "Relative RMS error of the scene relit with the first relighting pattern, as if the "
        "acquisition had stopped after each level, against the patterns shown by then and, above, "
        f"the minutes that they take at {inputs.config.capture.seconds_per_pattern:g} s a pattern. "
        "Methods that fit all their pictures together have their last level alone. Dotted: the "
        "patterns of brute force."
    )
    known = set(inputs.speed_error["scene"])
    scenes = [scene for scene in inputs.scenes if scene in known]
    curves = [
        Illustration(
            "Speed against error",
            caption,
            f"speed_error{suffix}",
            charts.speed_error_figure(inputs, part),
            alt=_speed_in_words(inputs, part),
        )
        for part, suffix in _parts(scenes)
    ]
    table = Tabulation("Error after each level", "As in the plot.", tables.speed_table(inputs))
    return Section("speed", "Speed against error", [*curves, table])


def _speed_in_words(inputs: Inputs, scenes: Sequence[str]) -> str:
    """Say where each method's curve begins and ends."""
    table = inputs.speed_error
    ends = [
        f"{words(scene)}, {methods.listed([str(method)])}: "
        + ", ".join(
            f"{percent(row.error)} % after {number(row.patterns)} patterns"
            for row in (own.iloc[0], own.iloc[-1])
        )
        for (scene, method), own in table[table["scene"].isin(scenes)].groupby(
            ["scene", "method"], sort=False
        )
    ]
    return "Error against patterns. " + ". ".join(ends) + "."
