"""Dual photography's patterns against the projector's resolution [thesis Fig. 3.8]."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.evaluating.studies.physical import (
    Arrays,
    Rows,
    acquired,
    even_shape,
    physical_scene,
    white,
)
from rfpipe.stages.evaluating.studies.poses import aside

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.stages.acquire import AcquisitionResult
    from rfpipe_mitsuba.scene import MitsubaScene

__all__ = ["growth_study"]

_SIZES = 5


class _Coarse:
    """A scene before a projector of larger pixels, each `factor` of the scene's own along a side.

    The camera stays as it is, as the thesis' did.
    """

    def __init__(self, scene: MitsubaScene, factor: int) -> None:
        self._scene, self._factor = scene, factor
        height, width = scene.projector_shape
        self.camera_shape = scene.camera_shape
        self.projector_shape = (height // factor, width // factor)
        self.channels = scene.channels

    def apply(self, patterns: NDArray[np.float32]) -> NDArray[np.float32]:
        """Radiance (B, M, C) under patterns (B, N)."""
        coarse = patterns.reshape(len(patterns), *self.projector_shape)
        return self._scene.apply(coarse.repeat(self._factor, 1).repeat(self._factor, 2))


def growth_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire the box and the bottle at five resolutions of the projector, by dual photography.

    Returns
    -------
    rows : list of dict
        ``scene`` ("box", "bottle"), ``side``, ``rays``, ``levels`` of the block tree,
        ``patterns``, ``blocks``: those of all levels, each lit alone by brute force, and ``error``
        of the floodlit picture relit. ``by_level``: of each level ``level``, ``blocks``,
        ``patterns``, and ``told_apart``: how many of the blocks above a camera pixel sees that are
        subdivided for it, in the mean over the camera; these conflict with each other.
    arrays : dict
        Empty.
    """
    shape = even_shape(config)
    rows: Rows = []
    for name, scene in (
        ("box", aside(config, "two_blocks", shape=shape)),
        ("bottle", physical_scene(config, "bottle", shape=shape)),
    ):
        full = scene.projector_shape[0]
        for halvings in reversed(range(min(_SIZES, int(np.log2(full))))):
            coarse = _Coarse(scene, 2**halvings)
            result, _ = acquired(config, coarse, "dual")
            light = white(coarse.projector_shape)
            truth = coarse.apply(light[None]).reshape(*coarse.camera_shape, coarse.channels)
            by_level = _by_level(result, coarse)
            rows.append(
                {
                    "scene": name,
                    "side": coarse.projector_shape[0],
                    "rays": light.size,
                    "levels": BlockTree(RayDomain(coarse.projector_shape)).n_levels,
                    "patterns": result.patterns,
                    "blocks": sum(level["blocks"] for level in by_level),
                    "by_level": by_level,
                    "error": relative_rms(result.transport.relight(light), truth),
                }
            )
    return rows, {}


def _by_level(result: AcquisitionResult, scene: _Coarse) -> list[dict[str, float]]:
    """Tell where the patterns of an acquisition went."""
    tree = BlockTree(RayDomain(scene.projector_shape))
    pixels = int(np.prod(scene.camera_shape))
    subdivided = 0
    told = []
    for row in result.levels.to_dict("records"):
        level = int(row["level"])
        told.append(
            {
                "level": level,
                "blocks": tree.n_blocks(level),
                "patterns": int(row["patterns"]),
                "told_apart": subdivided / pixels,
            }
        )
        subdivided = int(row["subdivided"])
    return told
