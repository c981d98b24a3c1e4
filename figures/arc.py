"""Fig. 3.9: a 6D field; one projector, a camera that goes along an arc."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from figures.common import (
    Items,
    Picture,
    Size,
    acquired,
    cost,
    dual_truth,
    error,
    exposure,
    matte,
    percent,
    physical,
    size_of,
    white,
)
from rfpipe.report.drawing import Panel, difference, draw

_WORLD = "still_life_arc"
_AREA = (0.6, 0.9)  # of the arc that the area light takes: beside the projector, to show shadows
_CAMERA_SHARE = 2  # the camera's pixels are larger: at a light they are all one


def items(size: Size) -> Items:
    """Acquire a still life from each camera position, and relight its dual picture from there."""
    from rfpipe.mitsuba.worlds import WORLDS

    world = WORLDS[_WORLD]
    projectors = [projector.model_dump() for projector in world.projectors or ()]

    def scene_at(index: int, side: int) -> Any:
        shapes = {"shape": (side, side), "projector_shape": (size.side, size.side)}
        camera = world.cameras[index].model_dump()
        return physical(size, _WORLD, cameras=[camera], projectors=projectors, **shapes)

    last = len(world.cameras) - 1
    chosen = np.linspace(0, last, min(size.positions, last + 1)).round().astype(int)
    results, relit, true = [], [], []
    for index in chosen:
        scene = scene_at(int(index), max(2, size.side // _CAMERA_SHARE))
        results.append(acquired(scene, "dual")[0])
        light = white(scene.camera_shape)
        relit.append(results[-1].transport.T.relight(light))
        true.append(dual_truth(scene, light))
    middle = scene_at(len(world.cameras) // 2, size.side)
    pattern = matte(middle.camera_shape)
    first, end = (round(share * (len(chosen) - 1)) for share in _AREA)
    pairs = {
        "light on the left": (relit[0], true[0]),
        "light on the right": (relit[-1], true[-1]),
        "area light": tuple(
            np.mean(pictures[first : end + 1], axis=0) for pictures in (relit, true)
        ),
        "high-resolution matte": (
            acquired(middle, "dual")[0].transport.T.relight(pattern),
            dual_truth(middle, pattern),
        ),
    }
    area, striped = (error(*pairs[name]) for name in ("area light", "high-resolution matte"))
    patterns = sum(result.patterns for result in results)
    caption = (
        f"{len(chosen)} positions, {patterns:,} patterns. Errors: area light {percent(area)}, "
        f"matte {percent(striped)}, worst position {percent(max(map(error, relit, true)))}. A "
        "third of the positions, on the right, make the area light; one throws the matte "
        f"alone. {size_of(scene)}"
    )
    thesis = (
        "of 80 camera positions each becomes a light: from the left, from the right, all together "
        "an area light with soft shadows, and a high-resolution matte."
    )
    figure = draw(_rows(pairs, exposure(true[0], pairs["area light"][1])))
    yield Picture("fig_3_9", "Fig. 3.9", thesis, caption, figure)
    row = cost("3.1", "Fig. 3.9, 80 positions", scene, results[-1], area, positions=len(chosen))
    yield replace(
        row,
        patterns=patterns,
        pictures=sum(result.pictures for result in results),
        megabytes=sum(result.transport.nbytes for result in results) / 1e6,
        processing_s=sum(result.processing_seconds for result in results),
    )


def _rows(pairs: dict[str, tuple[Any, Any]], bright: float) -> list[list[Any]]:
    """Return rows of relit pictures, truths and differences; mattes have their own white."""
    whites = {
        name: exposure(pair[1]) if "matte" in name else bright for name, pair in pairs.items()
    }
    return [
        [Panel(ours, name, "relit", whites[name]) for name, (ours, _) in pairs.items()],
        [Panel(truth, name, "ground truth", whites[name]) for name, (_, truth) in pairs.items()],
        [difference(*pair, whites[name]) for name, pair in pairs.items()],
    ]
