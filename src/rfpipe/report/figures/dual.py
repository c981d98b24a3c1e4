"""Dual photography's pictures [thesis Fig. 3.1 to 3.7, 3.9, 3.10]."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe.report.blocks import Illustration, Section
from rfpipe.report.drawing import Drawing, new_figure, show_image
from rfpipe.report.figures.panels import (
    compared,
    draw_levels,
    draw_panels,
    exposure,
    light_of,
    size_of,
    with_errors_below,
)
from rfpipe.report.inputs import Study
from rfpipe.report.light import Light
from rfpipe.report.text import percent, words

__all__ = [
    "arc_section",
    "bottle_section",
    "box_section",
    "right_angles_section",
    "samples_section",
    "walk_section",
]

_LEVELS = 4  # of the walk-through


def walk_section(study: Study) -> Section:
    """Fig. 3.1."""
    counts = {row["case"]: row["patterns"] for row in study.rows}
    figure, axes = new_figure(2, _LEVELS, (8.0, 4.4))
    for row, case in zip(axes, ("without", "with"), strict=True):
        for level, axis in enumerate(row):
            _draw_frames(axis, study.images.read(f"{case}_{level}"))
            axis.set_title(f"level {level + 1}", fontsize=8.5, pad=3)
        row[0].set_ylabel(f"{case} conflicts:\n{counts[case]} patterns", fontsize=8.5)
    caption = (
        "Patterns of an 8 x 8 projector, level by level; the number in a block is that of the "
        "frame that lights it, blocks of one number are lit together. Above, no camera pixel sees "
        "two blocks; below, two pixels see light of block 2 (upper left) as well as of block 4 "
        "(lower right), so that their children are never lit in one frame. Brute force takes 64."
    )
    block = Illustration("Fig. 3.1", caption, "fig_3_1", figure, "Fig. 3.1")
    return Section(
        "walk", "Adaptive patterns, step by step (Fig. 3.1)", [block], (), [study.source]
    )


def _draw_frames(axis: Any, frames: Any) -> None:
    """Draw a level: colours for frames, and the frame's number once a block."""
    show_image(axis, frames, cmap="Pastel1", vmin=1, vmax=max(int(frames.max()), 9))
    side = len(frames)
    seen = np.unique(frames)
    # as large as the blocks of this level
    length = side
    while length > 1 and not _is_blocky(frames, length):
        length //= 2
    for top in range(0, side, length):
        for left in range(0, side, length):
            middle = (length - 1) / 2
            axis.text(
                left + middle, top + middle, str(frames[top, left]), ha="center", va="center",
                fontsize=6.5 if len(seen) > 1 and length == 1 else 8.5,
            )  # fmt: skip


def _is_blocky(frames: Any, length: int) -> bool:
    parts = frames.reshape(len(frames) // length, length, -1, length)
    return bool((parts == parts[:, :1, :, :1]).all())


def box_section(study: Study) -> Section:
    """Fig. 3.3 and 3.4."""
    rows = {row["case"]: row for row in study.rows}
    images = study.images.read
    white = exposure(images("dual_truth"))
    primal, pixel, ours, truth = (
        light_of(study, name, what, white)
        for name, what in (
            ("primal", "primal"),
            ("dual_pixel", "dual, pixel level"),
            ("dual_hierarchy", "dual, hierarchy"),
            ("dual_truth", "dual, ground truth"),
        )
    )
    kept = {case: percent(row["kept"]) for case, row in rows.items()}
    drawing = with_errors_below(
        [
            [
                ("primal: the camera's view", primal, ""),
                ("dual: pixel level", pixel, f"keeps {kept['pixel']} % of\ninter-reflected light"),
                ("dual: hierarchy", ours, f"keeps {kept['hierarchy']} % of\ninter-reflected light"),
                ("dual: ground truth", truth, ""),
            ]
        ],
        [None, (pixel, truth), (ours, truth)],
    )
    caption = (
        "A box with a red and a green wall and two white blocks, camera in front, projector to its "
        "right and above. The dual pictures show it from the projector, lit from the camera. "
        "Subdivided down to the pixel, what the walls throw on the blocks and on each other is "
        "below the camera's noise and lost: the picture has direct light alone. Stored "
        "at the level where it was last measured, it stays. The camera gets a tenth of the run's "
        f"light. {size_of(rows['hierarchy'])}"
    )
    first = Illustration("Fig. 3.3", caption, "fig_3_3", drawing, "Fig. 3.3")
    return Section(
        "box",
        "Inter-reflections and the hierarchy (Fig. 3.3, 3.4)",
        [first, _levels_figure(study, rows["hierarchy"], white)],
        (),
        [study.source],
    )


def _levels_figure(study: Study, row: dict[str, Any], white: float) -> Illustration:
    """Fig. 3.4: what each level adds."""
    panels = []
    for level, patterns in enumerate(row["levels"]):
        radiance = study.images.read(f"level_{level}")
        own = min(white, exposure(radiance)) if radiance.max() > 0 else white
        light = Light(row["world"], f"level {level + 1}", radiance, own)
        shown = f"white at {own:.2g}" if radiance.max() > 0 else "nothing is stored here"
        panels.append((f"level {level + 1}", light, f"patterns {patterns}\n{shown}"))
    ours = light_of(study, "dual_hierarchy", "their sum", white, row["world"])
    last = ("their sum", ours, f"patterns {row['patterns']}\nwhite at {white:.2g}")
    caption = (
        "The dual picture, and what each level of the hierarchy adds to it, coarse to fine, each "
        "brightened so that it can be seen: its white is below it. Coarse levels hold the soft "
        "inter-reflected light, the last one direct light, edges and texture."
    )
    return Illustration("Fig. 3.4", caption, "fig_3_4", draw_levels(panels, last), "Fig. 3.4")


def bottle_section(study: Study) -> Section:
    """Fig. 3.2 and 3.6."""
    row = study.rows[0]
    images = study.images.read
    white, dual_white = exposure(images("primal")), exposure(images("dual_truth"))
    projected = Light("projector", "pattern", images("pattern")[..., None], 1.0, quantity="pattern")
    together = images("together")
    adapting = draw_panels(
        [
            [
                ("floodlit scene", light_of(study, "primal", "floodlit", white), ""),
                ("one pattern in the projector", projected, f"{images('pattern').mean():.0%} lit"),
                ("the same on the scene", light_of(study, "pattern_seen", "pattern", white), ""),
                (
                    "pixels lit together",
                    Light("projector", "lit together", together[..., None], float(together.max()),
                          quantity="pixels"),
                    f"black 0, white {together.max():.0f}",
                ),
            ]
        ]
    )  # fmt: skip
    about = (
        "The pattern of the last level that lights most pixels. Where the bottle spreads light "
        "over the scene, few projector pixels can be lit at once: it stays dark in the pattern. On "
        "the right, how many pixels of the projector were lit together with each pixel."
    )
    relit = _relit_figure(study, white, dual_white)
    caption = (
        "A bottle of water on a table. Above, as the camera sees it in the projector's light; "
        "below, as the projector sees it in the camera's. On the right relit by a high-frequency "
        "matte of diagonal stripes: caustics and what is seen through the bottle vary with it. "
        f"The bottle seen in one picture is the caustic in the other. {size_of(row)}"
    )
    return Section(
        "bottle",
        "Caustics (Fig. 3.2, 3.6)",
        [
            Illustration("Fig. 3.2", about, "fig_3_2", adapting, "Fig. 3.2"),
            Illustration("Fig. 3.6", caption, "fig_3_6", relit, "Fig. 3.6"),
        ],
        (),
        [study.source],
    )


def _relit_figure(study: Study, white: float, dual_white: float, prefix: str = "") -> Drawing:
    """Primal and dual pictures, floodlit and by the matte, with the dual one's error."""
    row = next(r for r in study.rows if not prefix or r["figure"].endswith(prefix.strip("_")))
    of = row["world"]
    rows, pairs = [], []
    for side, light in (("primal", white), ("dual", dual_white)):
        relit = f"{prefix}{side}_relit" if side == "primal" else f"{prefix}{side}"
        matte = f"{prefix}{side}_matte" + ("_relit" if side == "primal" else "")
        even = light_of(study, relit, f"{side}, even light", light, of)
        true = light_of(study, f"{prefix}{side}_truth", f"{side}, truth", light, of)
        striped = light_of(study, matte, f"{side}, matte", light, of)
        striped_true = light_of(
            study, f"{prefix}{side}_matte_truth", f"{side}, matte truth", light, of
        )
        key = "primal_matte_relit_error" if side == "primal" else "dual_matte_error"
        rows.append(
            [
                (f"{side}, relit", even, ""),
                (f"{side}, ground truth", true, ""),
                (f"{side}, relit by the matte", striped, f"error {percent(row[key])} %"),
                (f"{side}, matte, ground truth", striped_true, ""),
            ]
        )
        pairs.append((striped, striped_true))
    return compared(rows, pairs)


def samples_section(study: Study) -> Section:
    """Fig. 3.7."""
    panels = []
    for row in study.rows:
        place = row["figure"].split(", ")[1]
        white = exposure(study.images.read(f"{place}_primal"))
        dual = exposure(study.images.read(f"{place}_dual_truth"))
        pictures = [
            light_of(study, f"{place}_{name}", what, own, row["world"])
            for name, what, own in (
                ("primal", "primal", white),
                ("dual", "dual", dual),
                ("dual_truth", "dual, ground truth", dual),
            )
        ]
        below = ["", f"{row['patterns']} patterns, error {percent(row['error'])} %", ""]
        titles = [f"{words(row['world'])}: primal", "dual", "dual, ground truth"]
        panels.append(list(zip(titles, pictures, below, strict=True)))
    caption = (
        "Two more scenes, the projector aside from the camera and above: gloss and rough metal in "
        "a box, and print, rings and checks at grazing angles. Left as the camera sees "
        "them, then from the projector in the camera's light. "
        f"{size_of(study.rows[0])}"
    )
    pairs = [(row[1][1], row[2][1]) for row in panels]
    figure = Illustration("Fig. 3.7", caption, "fig_3_7", compared(panels, pairs), "Fig. 3.7")
    return Section("samples", "More dual pictures (Fig. 3.7)", [figure], (), [study.source])


def arc_section(study: Study) -> Section:
    """Fig. 3.9."""
    row = study.rows[0]
    white = exposure(study.images.read("area_truth"), study.images.read("left_truth"))
    titles = {
        "left": "light on the left",
        "right": "light on the right",
        "area": "area light",
        "matte": "high-resolution matte",
    }
    whites = dict.fromkeys(titles, white) | {"matte": exposure(study.images.read("matte_truth"))}
    rows = [
        [
            (title, light_of(study, name + suffix, f"{title}, {how}", whites[name]), how)
            for name, title in titles.items()
        ]
        for suffix, how in (("", "relit"), ("_truth", "ground truth"))
    ]
    pairs = [(ours[1], true[1]) for ours, true in zip(*rows, strict=True)]
    caption = (
        "A still life as the projector sees it, its transport acquired for "
        f"{row['positions']} positions of the camera on an arc. Each position becomes a light: one "
        "on the left, one on the right, with the hard shadow that a point throws; a third of them "
        "on the right together, an area light, whose shadows are soft; and a matte of diagonal "
        "stripes that one position throws. In the middle the same by the true matrix, below the "
        f"difference. {size_of(row)}"
    )
    drawing = with_errors_below(rows, pairs)
    figure = Illustration("Fig. 3.9", caption, "fig_3_9", drawing, "Fig. 3.9")
    return Section("arc", "A 6D field (Fig. 3.9)", [figure], (), [study.source])


def right_angles_section(study: Study) -> Section:
    """Fig. 3.10."""
    row = study.rows[0]
    white, dual = (exposure(study.images.read(name)) for name in ("primal", "dual_truth"))
    primal = light_of(study, "primal", "primal", white)
    ours, truth = (
        light_of(study, name, what, dual)
        for name, what in (("dual", "dual"), ("dual_truth", "dual, ground truth"))
    )
    panels = [
        ("(a) primal", primal, ""),
        ("(b) dual", ours, f"error {percent(row['error'])} %"),
        ("dual, ground truth", truth, ""),
    ]
    caption = (
        "Camera above, projector in front, at right angles, and a mirror beside the block that the "
        "camera sees nearly edge on. Of the surfaces that face the projector the camera sees few "
        f"directly: {percent(row['coarse'])} % of the dual picture's light is stored at levels "
        "coarser than a pixel, which blurs it there. The block's reflection in the mirror is "
        f"captured. {size_of(row)}"
    )
    drawing = compared([panels], [(ours, truth)])
    figure = Illustration("Fig. 3.10", caption, "fig_3_10", drawing, "Fig. 3.10")
    return Section("right_angles", "At right angles (Fig. 3.10)", [figure], (), [study.source])
