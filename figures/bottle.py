"""Figs. 3.2 and 3.6: glass that throws caustics, and how patterns adapt to it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from figures.common import (
    Items,
    Picture,
    Size,
    acquired,
    cost,
    exposure,
    percent,
    physical,
    seen,
    size_of,
)
from figures.relit import relit
from rfpipe.array_types import Float
from rfpipe.report.drawing import Panel, draw

_COARSE = 3e-2  # tolerance of the patterns shown: the noise of a camera of 2006
_MANY = 4.0  # times the camera pixels that a median projector pixel lights
_LEAST_LIT = 0.01  # of the light of the projector pixel that most comes back from


def items(size: Size) -> Items:
    """Acquire the bottle; look at the last level's patterns at a coarse tolerance."""
    scene = physical(size, "bottle", shape=size.even)
    drawn = relit(scene)
    _, rig = acquired(scene, "dual", tolerance=_COARSE)
    patterns = rig.levels[drawn.result.transport.last_level]
    chosen = max(patterns, key=lambda pattern: float(pattern.mean()))
    together = np.zeros(chosen.shape, np.float32)
    for pattern in patterns:
        together[pattern > 0] = float((pattern > 0).sum())
    bright = exposure(drawn.truths["primal"])
    brightest = float(together.max())
    row = [
        Panel(drawn.truths["primal"], "floodlit scene", "", bright),
        Panel(chosen, "one pattern in the projector", f"{chosen.mean():.0%} lit"),
        Panel(seen(scene, chosen), "the same on the scene", "", bright),
        Panel(together, "pixels lit together", f"black 0, white {brightest:.0f}", brightest),
    ]
    glass, elsewhere = _means(scene, together)
    caption = (
        f"Pixels lit together with a pixel at the last level, in the mean: {glass:.0f} where light "
        f"is spread over much of the picture, {elsewhere:.0f} elsewhere. The pattern is the one of "
        "that level that lights most pixels."
    )
    thesis = (
        "patterns adapt to the scene: where a bottle spreads light only few pixels can be lit at "
        "once, elsewhere many."
    )
    yield Picture("fig_3_2", "Fig. 3.2", thesis, caption, draw([row]))
    caption = (
        "Above as the camera sees the bottle in the projector's light, below as the projector sees "
        "it in the camera's; errors of the pictures by the matte of diagonal stripes: primal "
        f"{percent(drawn.error('primal_matte'))}, dual {percent(drawn.error('dual_matte'))}. "
        f"{size_of(scene)}"
    )
    thesis = (
        "light through a bottle is captured: caustics, seen from the camera and from the "
        "projector, vary with a high-frequency pattern that relights the dual image."
    )
    rows = [drawn.row(side, f"{side}_matte") for side in ("primal", "dual")]
    yield Picture("fig_3_6", "Fig. 3.6", thesis, caption, draw(rows))
    yield cost("3.1", "Fig. 3.6, bottle", scene, drawn.result, drawn.error("dual"))


def _means(scene: Any, together: Float) -> tuple[float, float]:
    """Return the means over pixels that light much more than the median one, and the others."""
    light: NDArray[Any] = sum(scene.dense(channel) for channel in range(scene.channels))
    total = light.sum(axis=0)
    lights = total > _LEAST_LIT * total.max()
    spread = total**2 / np.maximum(np.square(light).sum(axis=0), np.finfo(float).tiny)
    spreads = spread > _MANY * np.median(spread[lights])
    flat = together.ravel()
    glass, elsewhere = flat[lights & spreads], flat[lights & ~spreads]
    return (float(glass.mean()) if glass.size else float("nan")), float(elsewhere.mean())
