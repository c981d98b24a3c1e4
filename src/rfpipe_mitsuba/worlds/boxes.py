"""Open boxes: light between matt walls, which everybody's renderer is tried on."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe_mitsuba.views import Vector, View
from rfpipe_mitsuba.world import World
from rfpipe_mitsuba.worlds.parts import box, matt, sheet

__all__ = ["BOXES", "BOX_VIEW", "aside", "walls"]

BOX_VIEW = View((0, 0, 3.9), (0, 0, 0), degrees=39.3)
"""A pinhole before the open side of `walls`, which fill its picture."""

_WHITE, _RED, _GREEN = (0.75, 0.72, 0.68), (0.57, 0.06, 0.05), (0.12, 0.4, 0.1)


def aside(degrees: float, distance: float, target: Vector, rise: float, field: float) -> View:
    """Return a view some degrees to the right of the z axis through its target.

    Parameters
    ----------
    degrees
        Around the vertical through the target.
    distance
        From that vertical.
    target
        At what it looks.
    rise
        How far above its target it stands.
    field
        Its field of view in degrees.
    """
    turn = float(np.radians(degrees))
    x, y, z = target
    origin = (x + distance * np.sin(turn), y + rise, z + distance * np.cos(turn))
    return View((float(origin[0]), float(origin[1]), float(origin[2])), target, degrees=field)


def walls(left: tuple[float, ...] = _WHITE, right: tuple[float, ...] = _WHITE) -> dict[str, Any]:
    """Return the five walls of a box from -1 to 1, open towards the viewer."""
    white = matt(*_WHITE)
    return {
        "type": "scene",
        "floor": sheet((0, -1, 0), (1, 0, 0), (0, 0, -1), white),
        "ceiling": sheet((0, 1, 0), (1, 0, 0), (0, 0, 1), white),
        "back": sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), white),
        "left": sheet((-1, 0, 0), (0, 0, -1), (0, 1, 0), matt(*left)),
        "right": sheet((1, 0, 0), (0, 0, 1), (0, 1, 0), matt(*right)),
    }


def _with_blocks() -> dict[str, Any]:
    white = matt(*_WHITE)
    return walls(_RED, _GREEN) | {
        "tall": box((-0.33, -0.4, -0.28), (0.6, 1.2, 0.6), 18, white),
        "short": box((0.33, -0.7, 0.38), (0.6, 0.6, 0.6), -17, white),
    }


BOXES = (
    World("red_wall_box", "colour bleeding in a diffuse cavity", lambda: walls(_RED), (BOX_VIEW,)),
    World("two_blocks", "shadows and occlusion between matt surfaces", _with_blocks, (BOX_VIEW,)),
    World(
        "two_blocks_aside",
        "the same, lit from 35 degrees aside: shadows that the camera sees, so that rows and "
        "columns without direct light",
        _with_blocks,
        (BOX_VIEW,),
        (aside(35, 1.6, (0, -0.1, 0), 0.35, 84),),  # in front of the open side
    ),
)
