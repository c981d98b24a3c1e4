"""Fig. 5.8: an 8D field, 3 x 3 coaxial views of a physically based scene."""

from __future__ import annotations

import numpy as np

from figures.common import (
    Items,
    Picture,
    Size,
    acquired,
    cost,
    error,
    exposure,
    matte,
    percent,
    physical,
    size_of,
)
from figures.light_field import THESIS, arrays_of_views
from rfpipe.array_types import Float
from rfpipe.report.drawing import Panel, difference, draw

_SHARE = 3  # of the figures' side: there are 9 x 9 pairs of views
_LEAST = 12  # pixels a view's side
_TOLERANCE = 3e-3  # below it noise of so few paths of light is subdivided
_PERIOD = 4  # pixels, of the matte


def items(size: Size) -> Items:
    """Acquire an array of 3 x 3 coaxial views by symmetric photography."""
    side = max(_LEAST, size.side // _SHARE)
    scene = physical(size, "views_3x3", shape=(side, side))
    result, _ = acquired(scene, "symmetric", tolerance=_TOLERANCE)
    count = scene.projector_shape[0]
    lights = np.zeros((count + 1, *scene.projector_shape), np.float32)
    lights[range(count), range(count)] = 1
    lights[count, 0] = matte(scene.projector_shape, _PERIOD)[0]
    relit = result.transport.relight_batch(lights)
    truth = scene.apply(lights.reshape(len(lights), -1)).reshape(relit.shape)
    middle = count // 2
    moves = [_least_change(truth[:count, middle]), _least_change(truth[middle])]
    remark = (
        f"{result.patterns:,} patterns at a tolerance of {_TOLERANCE:g}. Another light changes the "
        f"picture by {percent(moves[0])} at least, another view by {percent(moves[1])}. "
        f"{size_of(scene)}"
    )
    yield from arrays_of_views(relit[:count], truth[:count], remark)
    ours, true = relit[count, middle], truth[count, middle]
    bright, lit = exposure(true), truth[:count].sum(axis=0)[middle]
    panels = [
        Panel(lit, "lit by all projectors", "ground truth", exposure(lit)),
        Panel(lights[count, 0], "the first projector's pattern", "upper left of the array"),
        Panel(ours, "the middle view, relit", f"error {percent(error(ours, true))}", bright),
        Panel(true, "ground truth", "", bright),
        difference(ours, true, bright),
    ]
    caption = "The middle view when the projector at the array's upper left throws stripes."
    figure = draw([panels])
    yield Picture("fig_5_8_c", "Fig. 5.8, a pattern from aside", THESIS, caption, figure)
    yield cost("5.1", "Fig. 5.8, 8D", scene, result, error(relit[:count], truth[:count]))


def _least_change(pictures: Float) -> float:
    """Return the least relative difference of a picture from the middle one."""
    middle = len(pictures) // 2
    other_views = np.delete(pictures, middle, axis=0)
    return min(error(picture, pictures[middle]) for picture in other_views)
