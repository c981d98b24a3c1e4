"""Where the thesis' rigs stand before physically based scenes."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.stages.evaluating.studies.physical import physical_scene

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe_mitsuba.scene import MitsubaScene
    from rfpipe_mitsuba.views import View

__all__ = ["aside", "turned"]

_RIGHT, _UP = 22.0, 12.0  # degrees from the camera to the projector


def turned(view: View, right: float, up: float = 0.0) -> dict[str, Any]:
    """Return a pinhole as settings, gone round its target to the right and up, in degrees."""
    target = np.array(view.target)
    out = np.array(view.origin) - target
    upward = np.array(view.up) / np.linalg.norm(view.up)
    out = _rotated(out, upward, np.radians(right))
    across = np.cross(upward, out)
    out = _rotated(out, across / np.linalg.norm(across), -np.radians(up))
    origin = tuple(float(x) for x in target + out)
    return {**asdict(view), "origin": origin}


def _rotated(vector: Any, axis: Any, angle: float) -> Any:
    """Turn a vector about a unit axis (Rodrigues)."""
    along = axis * (axis @ vector)
    return along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector)


def aside(
    config: Config, name: str, right: float = _RIGHT, up: float = _UP, **changes: Any
) -> MitsubaScene:
    """Return a scene seen by its first camera, the projector degrees to its right and above."""
    from rfpipe_mitsuba.worlds import WORLDS

    camera = WORLDS[name].cameras[0]
    rig = {"cameras": [asdict(camera)], "projectors": [turned(camera, right, up)]}
    return physical_scene(config, name, **rig, **changes)
