"""Surfaces that reflect by angle: gloss, rough metal, mirrors.

Where a mirror, or glass, stands between a surface and the camera as well as between it and the
projector, the light that takes both ways isn't followed: what the mirror shows is lit by the rest.
"""

from __future__ import annotations

from typing import Any

from rfpipe_mitsuba.views import View
from rfpipe_mitsuba.world import World
from rfpipe_mitsuba.worlds.boxes import aside, walls
from rfpipe_mitsuba.worlds.parts import (
    ball,
    box,
    gloss,
    matt,
    metal,
    mirror,
    painted,
    pillar,
    sheet,
)
from rfpipe_mitsuba.worlds.textures import checks, lettering

__all__ = ["SHINY"]

_ABOVE = View((0, 0.5, 3.9), (0, -0.28, 0), degrees=33)
_AT_MIRROR = View((0, 0.4, 3.9), (0.05, -0.4, 0), degrees=31)
_FROM_ABOVE = View((-0.1, 4.0, 0.25), (-0.1, -0.5, 0.15), up=(0, 0, -1), degrees=30)


def _glossy() -> dict[str, Any]:
    return walls() | {
        "floor": sheet((0, -1, 0), (1, 0, 0), (0, 0, -1), painted(checks(8, 8))),
        "plastic": ball((-0.5, -0.62, 0.25), 0.38, gloss(0.08, 0.5, 0.05, 0.04)),
        "copper": ball((0.42, -0.65, 0.4), 0.35, metal(0.3, 0.93, 0.6, 0.45)),
        "steel": box((0.05, -0.45, -0.45), (0.55, 1.1, 0.4), 28, metal(0.25, 0.75, 0.76, 0.78)),
    }


def _mirrored() -> dict[str, Any]:
    return {
        "type": "scene",
        "floor": sheet((0, -1, 0), (1.6, 0, 0), (0, 0, -1.6), painted(checks(12, 12))),
        "back": sheet((0, 0, -1.6), (1.6, 0, 0), (0, 1, 0), matt(0.6, 0.62, 0.66)),
        "mirror": sheet((0.75, -0.4, -0.2), (0.4, 0, 0.37), (0, 0.6, 0), mirror()),
        "block": box((-0.4, -0.55, 0.1), (0.9, 0.9, 0.5), 53, matt(0.1, 0.25, 0.5)),
        "letters": sheet(
            (-0.196, -0.55, 0.253), (0.25, 0, -0.333), (0, 0.4, 0), painted(lettering(["EG", "SR"]))
        ),
        "ball": ball((0.2, -0.8, 0.6), 0.2, matt(0.65, 0.25, 0.05)),
    }


def _at_right_angles() -> dict[str, Any]:
    """A box before a mirror that the camera sees edge on, and the projector in full [Fig. 3.10]."""
    letters = painted(lettering(["EGSR", "DUAL"], ink=(0.5, 0.05, 0.05)))
    return {
        "type": "scene",
        "floor": sheet((0, -1, 0), (2, 0, 0), (0, 0, -2), matt(0.65, 0.62, 0.55)),
        "back": sheet((0, -0.3, -1.3), (1.3, 0, 0), (0, 0.7, 0), matt(0.5, 0.55, 0.65)),
        "mirror": sheet((-0.85, -0.5, 0.05), (0.3, 0.0, -0.6), (0.08, 0.5, 0.04), mirror()),
        "block": box((0.25, -0.7, 0.15), (0.6, 0.6, 0.6), 25, matt(0.6, 0.45, 0.2)),
        "lid": sheet((0.25, -0.395, 0.15), (0.26, 0, -0.12), (-0.12, 0, -0.26), letters),
        "post": pillar((0.85, -1, -0.6), 0.9, 0.14, matt(0.15, 0.45, 0.2)),
        "knob": ball((0.85, -0.06, -0.6), 0.16, matt(0.6, 0.5, 0.15)),
        "ball": ball((-0.25, -0.82, 0.75), 0.18, matt(0.6, 0.12, 0.1)),
    }


SHINY = (
    World(
        "glossy_metal",
        "highlights and blurred reflections: gloss and rough metal in a box",
        _glossy,
        (_ABOVE,),
    ),
    World(
        "mirror_beside",
        "a plane mirror beside an object: far pixels that see the same surface, and light thrown "
        "back on it",
        _mirrored,
        (_AT_MIRROR,),
        caustics=True,
    ),
    World(
        "right_angles",
        "camera above, projector in front, at right angles, and a mirror that the camera hardly "
        "sees [Fig. 3.10]",
        _at_right_angles,
        (_FROM_ABOVE,),
        (aside(8, 4.2, (-0.05, -0.55, 0), 0.7, 32),),
        caustics=True,
    ),
)
