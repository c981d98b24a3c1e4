"""Figs. 3.3 and 3.4: a box with coloured walls, down to the pixel and with a hierarchy."""

from __future__ import annotations

from typing import Any

from figures.common import (
    Items,
    Picture,
    Size,
    acquired,
    aside,
    cost,
    dual_truth,
    error,
    exposure,
    level_pictures,
    percent,
    seen,
    size_of,
    white,
)
from rfpipe.report.drawing import Panel, difference, draw

_DIM = 0.1  # of the camera's light: single pixels' inter-reflections sink into noise, as in 2006
_TO_THE_PIXEL = 1e-9  # tolerance at which nothing is stored at a coarse level but noise
_ABREAST = 4


def items(size: Size) -> Items:
    """Acquire the box twice, with a tenth of the default camera's light."""
    scene = aside(size, "two_blocks", shape=size.even)
    direct = aside(size, "two_blocks", shape=size.even, bounces=1)
    light = white(scene.camera_shape)
    truth, direct_truth = dual_truth(scene, light), dual_truth(direct, light)

    def kept(dual: object) -> float:
        return float((dual - direct_truth).sum() / (truth - direct_truth).sum())  # type: ignore[operator]

    pixel, _ = acquired(scene, "dual", _DIM, tolerance=_TO_THE_PIXEL)
    result, _ = acquired(scene, "dual", _DIM)
    parts = level_pictures(result, light)
    duals = {"pixel level": level_pictures(pixel, light)[-1], "hierarchy": sum(parts[1:], parts[0])}
    bright = exposure(truth)
    panels = [
        Panel(
            image,
            f"dual: {name}",
            f"keeps {percent(kept(image))} of\ninter-reflected light",
            bright,
        )
        for name, image in duals.items()
    ]
    primal = Panel(
        seen(scene, white(scene.projector_shape)), "primal: the camera's view", "", bright
    )
    top = [primal, *panels, Panel(truth, "dual: ground truth", "", bright)]
    errors = [None, *(difference(image, truth, bright) for image in duals.values())]
    ours = duals["hierarchy"]
    caption = (
        f"Inter-reflected light in the dual picture: {percent(kept(duals['pixel level']))} at the "
        f"pixel level, {percent(kept(ours))} with the hierarchy, whose picture is off by "
        f"{percent(error(ours, truth))}. Camera in front, projector to its right and above; the "
        f"camera gets a tenth of the default one's light. {size_of(scene)}"
    )
    thesis = (
        "down to single pixels the diffuse light from the red wall to the box is lost in the "
        "camera's noise; stored hierarchically it is kept."
    )
    yield Picture("fig_3_3", "Fig. 3.3", thesis, caption, draw([top, errors]))
    yield _levels(parts, result, Panel(ours, "their sum", f"patterns {result.patterns}", bright))
    yield cost("3.1", "Fig. 3.4, box", scene, result, error(ours, truth))


def _levels(parts: list[Any], result: Any, whole: Panel) -> Picture:
    """Draw the contribution of each level to the dual picture."""
    bright, levels = whole.white, []
    for level, (part, patterns) in enumerate(zip(parts, result.levels["patterns"], strict=False)):
        part_white = min(bright, exposure(part)) if part.max() > 0 else bright
        caption = f"white at {part_white:.2g}" if part.max() > 0 else "nothing is stored here"
        levels.append(
            Panel(part, f"level {level + 1}", f"patterns {patterns}\n{caption}", part_white)
        )
    levels.append(whole)
    rows = [levels[first : first + _ABREAST] for first in range(0, len(levels), _ABREAST)]
    caption = (
        "Contribution of each level to the dual picture, coarse to fine, brightened: the radiance "
        "shown as white is below it."
    )
    thesis = (
        "the dual image is the sum of the images of all levels, coarse ones with the diffuse "
        "inter-reflection that finer ones would lose."
    )
    return Picture("fig_3_4", "Fig. 3.4", thesis, caption, draw(rows))
