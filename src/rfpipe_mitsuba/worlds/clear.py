"""Glass and caustics, and bodies that light goes through.

Light that camera and projector both see through glass, or both by a mirror, isn't followed: behind
a glass ball the picture shows what lights the wall by other ways.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe_mitsuba.views import View
from rfpipe_mitsuba.world import World
from rfpipe_mitsuba.worlds.boxes import aside
from rfpipe_mitsuba.worlds.parts import (
    ball,
    body,
    box,
    glass,
    matt,
    metal,
    mirror,
    painted,
    pillar,
    sheet,
    turned,
)
from rfpipe_mitsuba.worlds.textures import checks, lettering

__all__ = ["CLEAR"]

_TABLE_VIEW = View((-0.25, 1.7, 3.6), (-0.25, -0.55, 0), degrees=33)
# Radii and heights of a filled bottle.
_BOTTLE = [
    (0, 0),
    (0.24, 0),
    (0.27, 0.03),
    *((0.27, height) for height in np.linspace(0.1, 0.75, 6)),
    *((0.175 + 0.095 * np.cos(t), 0.75 + 0.3 * np.sin(t / 2)) for t in np.linspace(0.4, np.pi, 8)),
    (0.08, 1.12),
    (0.08, 1.3),
    (0.07, 1.32),
    (0, 1.32),
]
_SWEETS = (
    # x, height above the floor, z, radius, and which colour
    (-0.18, 0.22, 0.13, 0.2, 0),
    (0.21, 0.21, 0.08, 0.19, 1),
    (0.0, 0.21, -0.25, 0.19, 2),
    (0.02, 0.53, 0.17, 0.2, 3),
    (-0.2, 0.56, -0.15, 0.19, 4),
    (0.22, 0.56, -0.17, 0.2, 0),
    (-0.16, 0.87, 0.1, 0.2, 1),
    (0.2, 0.9, 0.09, 0.18, 4),
    (0.0, 0.92, -0.24, 0.19, 3),
)
_SWEET_COLOURS = (
    (0.97, 0.35, 0.3),
    (0.45, 0.95, 0.4),
    (0.97, 0.9, 0.4),
    (0.97, 0.65, 0.25),
    (0.96, 0.95, 0.92),
)


def _table() -> dict[str, Any]:
    """A floor, and a wall behind it."""
    return {
        "type": "scene",
        "floor": sheet((0, -1, 0), (3, 0, 0), (0, 0, -3), matt(0.72, 0.7, 0.66)),
        "back": sheet((0, 0.4, -1.3), (3, 0, 0), (0, 1.4, 0), matt(0.45, 0.5, 0.6)),
    }


def _glass_ball() -> dict[str, Any]:
    return _table() | {
        "ball": ball((0.15, -0.55, 0), 0.44, glass()),
        "block": box((-0.85, -0.8, -0.75), (0.4, 0.4, 0.4), 20, matt(0.6, 0.2, 0.1)),
    }


def _bottle() -> dict[str, Any]:
    return _table() | {
        "bottle": turned((0.2, -0.999, 0.1), _BOTTLE, glass(1.4)),
        "block": box((-0.85, -0.8, -0.75), (0.4, 0.4, 0.4), 20, matt(0.15, 0.35, 0.6)),
    }


def _glass_and_ring() -> dict[str, Any]:
    """A mirror's ring, within which light gathers where the camera sees it, and a block of glass.

    A ball would be a cat's eye: lit and seen through it, its focus outshines all else.
    """
    return _table() | {
        "ring": pillar((-0.5, -0.999, 0.1), 0.32, 0.5, {"type": "twosided", "m": mirror()}),
        "block": box((0.5, -0.74, 0.15), (0.55, 0.5, 0.4), 25, glass()),
        "check": sheet((0.5, -0.3, -1.29), (0.6, 0, 0), (0, 0.3, 0), painted(checks(3, 6))),
    }


def _translucent() -> dict[str, Any]:
    marble = body(ball((-0.3, -0.52, 0.1), 0.46, {}), 0.08, 0.0, 0.98, 0.95, 0.88)
    soap = body(box((0.5, -0.72, 0.35), (0.5, 0.52, 0.5), -25, {}), 0.12, 0.5, 0.85, 0.97, 0.9)
    return _table() | {"marble": marble, "soap": soap}


def _sweets() -> dict[str, Any]:
    """Translucent balls in a tumbler that reflects a little, and bends nothing [Fig. 5.6]."""
    scene = {
        "type": "scene",
        "floor": sheet((0, -0.7, 0), (1.4, 0, 0), (0, 0, -1.4), matt(0.5, 0.48, 0.45)),
        "tumbler": pillar(
            (0, -0.699, 0),
            1.35,
            0.47,
            {
                "type": "mask",
                "opacity": 0.06,
                "sheen": {"type": "twosided", "material": metal(0.1, 0.9)},
            },
        ),
        "letters": sheet(
            (-0.02, -0.5, 0.6), (0.32, 0, 0), (0, 0.16, -0.06), painted(lettering(["EGSR"]))
        ),
    }
    for index, (x, height, z, radius, colour) in enumerate(_SWEETS):
        shape = ball((x, height - 0.69, z), radius, {})
        scene[f"sweet_{index}"] = body(shape, 0.09, 0.3, *_SWEET_COLOURS[colour])
    return scene


CLEAR = (
    World(
        "glass_ball",
        "a caustic that the camera sees directly: a ball of glass, lit from 50 degrees aside",
        _glass_ball,
        (_TABLE_VIEW,),
        (aside(50, 3.3, (0.0, -0.6, 0), 1.9, 33),),
        bounces=10,
        caustics=True,
    ),
    World(
        "bottle",
        "caustics of a bottle of water, lit from 60 degrees aside, which change places with what "
        "is seen through it in the dual image [Fig. 3.2, 3.6]",
        _bottle,
        (_TABLE_VIEW,),
        (aside(60, 3.5, (-0.05, -0.5, 0), 0.9, 33),),
        bounces=10,
        caustics=True,
    ),
    World(
        "glass_and_ring",
        "caustics of a coaxial rig: within a ring of a mirror, and about a block of glass, that is "
        "lit and seen through",
        _glass_and_ring,
        (View((0, 1.9, 3.2), (0, -0.8, 0), degrees=32),),
        bounces=10,
        caustics=True,
    ),
    World(
        "translucent",
        "light within bodies: one of marble and one of soap glow where they aren't lit",
        _translucent,
        (_TABLE_VIEW,),
        bounces=48,
    ),
    World(
        "sweets",
        "two coaxial pairs 120 degrees apart about translucent bodies in a tumbler, with letters "
        "before one side [Fig. 5.6, 5.11]",
        _sweets,
        (aside(0, 3.6, (0, -0.05, 0), 0.6, 24), aside(120, 3.6, (0, -0.05, 0), 0.6, 24)),
        bounces=48,
    ),
)
