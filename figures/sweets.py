"""Figs. 5.6 and 5.7: translucent sweets before two coaxial pairs, 120 degrees apart."""

from __future__ import annotations

from typing import Any

import numpy as np

from figures.common import (
    Items,
    Picture,
    Size,
    acquired,
    cost,
    error,
    exposure,
    percent,
    physical,
    seen,
    size_of,
    white,
    with_errors,
)
from rfpipe.array_types import Float
from rfpipe.report.drawing import Panel, difference, draw

_LETTERS = ("EG", "SR")
_BRIGHTER = 0.6  # of the radiance that is white elsewhere: the letters glow within dark sweets


def items(size: Size) -> Items:
    """Acquire sweets by symmetric photography; relight them by letters, level by level."""
    scene = physical(size, "sweets")
    result, _ = acquired(scene, "symmetric")
    front = np.zeros(scene.projector_shape, np.float32)
    front[0] = letters(front.shape[-1])
    front_and_back = front.copy()
    front_and_back[1] = 1
    rows, errors = [], []
    for pattern, name, of_pair, factor in (
        (front, "letters from the front", front[0], _BRIGHTER),
        (front_and_back, "and even light behind", white(front.shape[1:]), 1.0),
    ):
        relit, truth = result.transport.relight(pattern)[0], seen(scene, pattern)[0]
        bright = factor * exposure(truth)
        errors.append(error(relit, truth))
        rows.append(
            [
                Panel(of_pair, "a projector's pattern"),
                Panel(relit, name, f"error {percent(errors[-1])}", bright),
                Panel(truth, "ground truth", "", bright),
                difference(relit, truth, bright),
            ]
        )
    caption = (
        f"Errors: letters {percent(errors[0])}, with even light from behind {percent(errors[1])}; "
        f"{result.patterns:,} patterns for {int(np.prod(scene.projector_shape)):,} rays. All "
        f"pictures are seen from the front. {size_of(scene)}"
    )
    thesis = (
        "letters of light relight gummy bears from the front, with even light from behind, too, as "
        "the real projectors do."
    )
    yield Picture("fig_5_6", "Fig. 5.6", thesis, caption, draw(rows))
    yield _levels(scene, result, front)
    yield cost("5.1", "Fig. 5.6, gummy bears", scene, result, errors[1])


def _levels(scene: Any, result: Any, front: Float) -> Picture:
    """Draw the letters' picture as if the acquisition had stopped at each level."""
    truth = seen(scene, front)[0]
    bright = _BRIGHTER * exposure(truth)
    shown, levels, by_level = 0, [], []
    for row in result.levels.to_dict("records"):
        level, shown = int(row["level"]), shown + int(row["patterns"])
        picture: Float = result.transport.truncate(level).relight(front)[0]
        by_level.append(percent(error(picture, truth)))
        below = f"patterns {shown}\nerror {by_level[-1]}"
        levels.append(Panel(picture, f"level {level}", below, bright))
    thesis = (
        "stopped at any level, the picture has full resolution, but the pattern's light is spread "
        "over each block that it touches."
    )
    caption = f"The letters' picture as if stopped at each level; errors {', '.join(by_level)}."
    figure = draw(with_errors(levels, Panel(truth, "ground truth", "", bright)))
    return Picture("fig_5_7", "Fig. 5.7", thesis, caption, figure)


def letters(side: int) -> Float:
    """Return bright letters in the middle of a dark picture (side, side)."""
    from rfpipe.mitsuba.parts import lettering

    dots = lettering(_LETTERS, ink=(1, 1, 1), paper=(0, 0, 0), fine=1)[..., 0]
    rows, columns = dots.shape
    height = rows * (side // rows) or side
    width = max(1, columns * height // rows)
    drawn = dots[np.arange(height) * rows // height][:, np.arange(width) * columns // width]
    picture = np.zeros((side, side), np.float32)
    top, column = max(0, (side - height) // 2 - side // 16), (side - width) // 2  # on the sweets
    picture[top : top + height, column : column + width] = drawn
    return picture
