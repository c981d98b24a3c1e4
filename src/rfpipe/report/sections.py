"""The sections on the acquired scenes."""

from __future__ import annotations

from rfpipe.report import charts, matrices, pictures, tables
from rfpipe.report.blocks import Illustration, Section, Tabulation
from rfpipe.report.drawing import chunks
from rfpipe.report.inputs import METHOD_TITLES, Inputs, Run
from rfpipe.report.text import size, wishes
from rfpipe.report.thesis import DUAL_ON_SCENE_IV, PLANES_SHAPE, TABLE_5_1, numeral_of

__all__ = [
    "cost_section",
    "leaves_section",
    "levels_section",
    "matrices_section",
    "methods_section",
    "speed_section",
    "summary_section",
]

_ABREAST = 4
"""Scenes side by side in a figure."""


def summary_section(inputs: Inputs) -> Section:
    """Every run on one line."""
    per_pattern = inputs.config.capture.seconds_per_pattern
    config = inputs.config
    caption = (
        f"Patterns shown and the time to capture them at {per_pattern:g} s a pattern; bytes on "
        "disk; and the largest errors over the relighting patterns. Errors are relative RMS "
        "against the scene's exact light transport: in total, and on the pixels that the pattern "
        "leaves dark, which show indirect light alone. PSNR has the true image's maximum as its "
        "peak. CIEDE2000 is the mean over the pixels of linear RGB with sRGB primaries and D65, "
        "the true floodlit image's maximum shown as white."
    )
    about = (
        f"Asked for were {wishes(config)}. Brute force, one pattern for each projector pixel, is "
        "the yardstick."
    )
    detail = (
        "The same errors for each relighting pattern: bars, noise, a binary picture, a small "
        "spot, and the crease, a strip along which surfaces meet, where there is one. "
        "Noise lights every pixel, so that none is unlit; a scene without indirect light "
        "has nothing to compare there either."
    )
    if inputs.light_fields:
        detail += (
            " In a light field each view's projector shows the pattern. Surfaces behind its unlit "
            "pixels may be lit from other views; one view lights the first view's pixels alone, so "
            "that the unlit ones are those of all other views."
        )
    return Section(
        "summary",
        "At a glance",
        [about],
        [
            Tabulation("Results", caption, tables.error_summary(inputs)),
            Tabulation("Errors by pattern", detail, tables.errors_by_pattern(inputs)),
        ],
    )


def matrices_section(inputs: Inputs) -> Section:
    """Fig. 2.1 for each method."""
    blocks: list[Illustration | Tabulation] = []
    for method in inputs.methods:
        images = [run for run in inputs.of_method(method) if not run.is_light_field]
        parts = chunks(images, _ABREAST)
        for index, runs in enumerate(parts):
            suffix = f"_{index + 1}" if len(parts) > 1 else ""
            caption = (
                "(a) Albedo of the scene. (b) The scene under floodlight, rendered from the "
                "acquired T; the line marks the rays of (c) and (d). (c) Entries of T between "
                "the rays of that line, camera rays down and projector rays across, acquired and "
                f"true: mean of the channels, logarithmic over {matrices.DECADES} decades. The "
                "diagonal is direct light, the off-diagonal quarters light from one plane to the "
                "other, the diagonal quarters third bounces. (d) Level of the leaf that holds "
                "each entry: white the root, black single rays, pale blue empty. (e) Relit with a "
                f"vertical bar, unlit pixels {matrices.UNLIT_GAIN} times brighter; beside it the "
                "truth, and the difference before brightening."
            )
            if not all(run.has_leaf_levels for run in runs):
                caption = caption.replace(
                    "(d) Level of the leaf that holds each entry: white the root, black single "
                    "rays, pale blue empty. ",
                    "",
                )
            blocks.append(
                Illustration(
                    f"Fig. 2.1, {METHOD_TITLES[method].lower()}",
                    caption,
                    f"fig_2_1_{method}{suffix}",
                    matrices.matrices_figure(runs),
                )
            )
    return Section("matrices", "The transport matrices (Fig. 2.1)", [], blocks)


def cost_section(inputs: Inputs) -> Section:
    """Tables 5.1 and 3.1."""
    per_pattern = inputs.config.capture.seconds_per_pattern
    height, width = PLANES_SHAPE
    common = (
        f"Time is capture at {per_pattern:g} s a pattern plus the processing measured here, "
        f"without the reference brackets{_references(inputs)}; size is bytes on disk, compressed, "
        "1 MB = 10⁶ bytes. "
    )
    blocks: list[Illustration | Tabulation] = []
    if inputs.of_method("symmetric"):
        table, numbers = tables.table_5_1(inputs)
        caption = common + (
            f"The thesis' scenes I to IV have {size(height, width)} = {height * width:,} rays, its "
            f"gummy bears {size(240, 340)}, its light field {size(3, 3)} views of "
            f"{size(130, 200)}; 2 s a HDR image, processing included, on a computer of 2006."
        )
        blocks.append(Tabulation("Table 5.1, symmetric photography", caption, table, numbers))
    if inputs.of_method("dual"):
        table, numbers = tables.table_3_1(inputs)
        caption = common + (
            "A brute-force scan is computed: one pattern a ray, T as float32. The thesis' scenes "
            "are others (box, bottle, a moving camera), at 25 patterns a minute; on scene IV of "
            f"Fig. 2.1 at {size(height, width)} its dual photography took {DUAL_ON_SCENE_IV:,} "
            "patterns."
        )
        blocks.append(Tabulation("Table 3.1, dual photography", caption, table, numbers))
    return Section("cost", "Size, time and patterns (Tables 5.1 and 3.1)", [], blocks)


def _references(inputs: Inputs) -> str:
    """Say how long the all-off and all-on brackets of an acquisition take."""
    capture = inputs.config.capture
    if inputs.config.camera is None:
        return ""
    minutes = (capture.black_frames + capture.floodlit_frames) * capture.seconds_per_pattern / 60
    return (
        f" ({capture.black_frames} all-off and {capture.floodlit_frames} all-on ones, "
        f"{minutes:.1f} min)"
    )


def methods_section(inputs: Inputs) -> Section | None:
    """Fig. 5.9, for scenes with indirect light acquired with both methods."""
    scenes = []
    for scene in inputs.config.scenes:
        runs = {run.method: run for run in inputs.of_scene(scene)}
        if {"symmetric", "dual"} <= set(runs) and runs["symmetric"].has_indirect_light:
            scenes.append([runs["symmetric"], runs["dual"]])
    if not scenes:
        return None
    thesis = TABLE_5_1["Fig. 2.1 (IV)"].patterns
    caption = (
        "The right half of each scene is lit. The left half shows indirect light alone and is "
        "amplified by the factor given, the same in a row. Relative RMS error on the left half. "
        f"The thesis compares scene IV at {size(*PLANES_SHAPE)}: {thesis} "
        f"patterns against {DUAL_ON_SCENE_IV:,}; there, too, dual photography blurs what it can't "
        "resolve."
    )
    sections = [inputs.config.methods_of(dual.scene)["dual"] for _, dual in scenes]
    if not all(section.options()["subtract_stored"] for section in sections):
        caption += (
            " As in the thesis, what it stored for a coarse block is not taken out of the finer "
            "levels' images and can count twice, which shows as bright patches."
        )
    parts = chunks(scenes, _ABREAST)
    return Section(
        "methods",
        "Symmetric against dual photography (Fig. 5.9)",
        [],
        [
            Illustration(
                "Fig. 5.9",
                caption,
                f"fig_5_9{f'_{index + 1}' if len(parts) > 1 else ''}",
                pictures.methods_figure(part),
            )
            for index, part in enumerate(parts)
        ],
    )


def levels_section(inputs: Inputs) -> Section | None:
    """Fig. 5.7, for the last scene, with indirect light if there is one."""
    with_levels = [run for run in inputs.runs if len(run.facts["levels"]) > 1]
    if not with_levels:
        return None
    indirect = [run for run in with_levels if run.has_indirect_light]
    images = [run for run in with_levels if not run.is_light_field]
    last = (indirect or images or with_levels)[-1]
    runs = [run for run in with_levels if run.scene == last.scene]
    where = ", the middle view," if last.is_light_field else ""
    caption = (
        f"{last.title}{where} relit with the vertical bar, as if the acquisition had stopped at "
        "each level; patterns shown up to there, and the relative RMS error in total. Where leaves "
        "are products of two images, a picture has full resolution at every level, but the light "
        "of a lit pixel is spread over its whole block."
    )
    return Section(
        "levels",
        "Stopping at a level (Fig. 5.7)",
        [],
        [Illustration("Fig. 5.7", caption, "fig_5_7", pictures.levels_figure(runs))],
    )


def leaves_section(inputs: Inputs) -> Section | None:
    """Fig. 5.10."""
    runs = [run for run in inputs.runs if len(run.facts["levels"]) > 1]
    if not runs:
        return None
    groups = [
        [run for run in runs if run.method == method and run.is_light_field == is_field]
        for method in inputs.methods
        for is_field in (False, True)
    ]
    groups = [[run for run in own if charts.has_leaves_of_nodes(run)] for own in groups]
    rows: list[list[Run]] = [list(part) for own in groups for part in chunks(own, _ABREAST)]
    caption = (
        "What becomes of the nodes of each level, in per cent of the nodes measured at it. With "
        "symmetric photography a node is a pair of blocks; empty ones are the sparse part of T, "
        "rank-1 ones the data-sparse part. With dual photography a node is a block as seen by one "
        "camera pixel, and a leaf a response that is stored at this level. The last level's "
        "leaves are scalars."
    )
    if any(numeral_of(scene) == "I" for scene in inputs.config.scenes.values()):
        caption += " As in the thesis, scene I is the sparse one: most of its nodes are empty."
    return Section(
        "leaves",
        "Leaves at each level (Fig. 5.10)",
        [],
        [
            *(
                [Illustration("Fig. 5.10", caption, "fig_5_10", charts.leaves_figure(rows))]
                if rows
                else []
            ),
            Tabulation(
                "Levels", "Patterns and nodes of each level, added over the scenes of a method.",
                *tables.levels_table(inputs),
            ),
        ],
    )  # fmt: skip


def speed_section(inputs: Inputs) -> Section | None:
    """Speed against error."""
    if not len(inputs.speed_error):
        return None
    caption = (
        "Each scene acquired with other options, from coarse to fine, with the camera below. "
        "Relative RMS error against the patterns shown and, above, the minutes that they take at "
        f"{inputs.config.capture.seconds_per_pattern:g} s a pattern: the mean over the relighting "
        "patterns, the band their range. Dotted: the patterns of brute force. The table beside "
        "it has processing time, bytes, PSNR and CIEDE2000 as well."
    )
    known = set(inputs.speed_error["scene"])
    scenes = [scene for scene in inputs.config.scenes if scene in known and inputs.of_scene(scene)]
    parts = chunks(scenes, _ABREAST)
    return Section(
        "speed",
        "Speed against error",
        [],
        [
            *(
                Illustration(
                    "Speed against error",
                    caption,
                    f"speed_error{f'_{index + 1}' if len(parts) > 1 else ''}",
                    charts.speed_error_figure(inputs, part),
                )
                for index, part in enumerate(parts)
            ),
            Tabulation(
                "Cost at each tolerance",
                "Mean error over the relighting patterns. Processing in one process, without the "
                "simulation of the pictures.",
                tables.speed_table(inputs),
            ),
        ],
    )
