"""A 6D field: one projector, a camera that goes along an arc [thesis Fig. 3.9]."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.evaluating.studies.physical import (
    Arrays,
    Rows,
    acquired,
    cost,
    dual_truth,
    matte,
    physical_scene,
    white,
)

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe_mitsuba.scene import MitsubaScene

__all__ = ["arc_study"]

_WORLD = "still_life_arc"
_AREA = (0.6, 0.9)  # of the arc that the area light takes: beside the projector, to show shadows
_CAMERA_SHARE = 2  # the camera's pixels are so much larger: at a light they are all one


def arc_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire a still life from each camera position, and relight its dual picture from there.

    Returns
    -------
    rows : list of dict
        One row of Table 3.1: patterns, bytes and processing of all positions together; its
        ``error`` is the area light's, ``worst`` the largest of a position's dual picture,
        ``matte_error`` the matte's, ``positions`` their number.
    arrays : dict of ndarray
        Float32 (H, W, 3): ``left``, ``right``, ``area``, ``matte``, ``primal`` and, of the first
        four, ``{name}_truth``.
    """
    from rfpipe.config.figures import FiguresConfig
    from rfpipe_mitsuba.worlds import WORLDS

    asked = config.report.figures or FiguresConfig()
    world = WORLDS[_WORLD]
    cameras = world.cameras
    chosen = np.linspace(0, len(cameras) - 1, min(asked.positions, len(cameras))).round()
    small = max(2, asked.side // _CAMERA_SHARE)

    def scene_at(index: int, side: int) -> MitsubaScene:
        return physical_scene(
            config,
            _WORLD,
            cameras=[asdict(cameras[index])],
            projectors=[asdict(each) for each in world.projectors or ()],
            shape=(side, side),
            projector_shape=(asked.side, asked.side),
        )

    pictures, truths = [], []
    patterns = 0
    megabytes = processing = 0.0
    for index in chosen.astype(int):
        scene = scene_at(int(index), small)
        result, _ = acquired(config, scene, "dual")
        light = white(scene.camera_shape)
        pictures.append(result.transport.T.relight(light))
        truths.append(dual_truth(scene, light))
        patterns += result.patterns
        megabytes += result.transport.nbytes / 1e6
        processing += result.processing_seconds
    middle = scene_at(len(cameras) // 2, asked.side)
    fine, _ = acquired(config, middle, "dual")
    pattern = matte(middle.camera_shape)
    count = len(pictures)
    first, last = (round(share * (count - 1)) for share in _AREA)
    area = slice(first, last + 1)
    thrown = white(middle.projector_shape)
    arrays: Arrays = {
        "primal": middle.apply(thrown[None])[0].reshape(*middle.camera_shape, 3),
        "left": pictures[0],
        "right": pictures[-1],
        "area": np.mean(pictures[area], axis=0),
        "matte": fine.transport.T.relight(pattern),
        "left_truth": truths[0],
        "right_truth": truths[-1],
        "area_truth": np.mean(truths[area], axis=0),
        "matte_truth": dual_truth(middle, pattern),
    }
    row = cost(
        "3.1", "Fig. 3.9, 80 positions", scene, result, (arrays["area"], arrays["area_truth"])
    )  # fmt: skip
    row |= {
        "patterns": patterns,
        "megabytes": megabytes,
        "processing_s": processing,
        "positions": count,
        "worst": max(map(relative_rms, pictures, truths)),
        "matte_error": relative_rms(arrays["matte"], arrays["matte_truth"]),
    }
    return [row], arrays
