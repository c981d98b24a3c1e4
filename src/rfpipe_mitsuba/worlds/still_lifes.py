"""Scenes of fine detail, and of many views."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe_mitsuba.views import View
from rfpipe_mitsuba.world import World
from rfpipe_mitsuba.worlds.boxes import BOX_VIEW, aside, walls
from rfpipe_mitsuba.worlds.parts import (
    ball,
    box,
    gloss,
    matt,
    painted,
    pillar,
    sheet,
    turned,
)
from rfpipe_mitsuba.worlds.textures import blots, checks, lettering

__all__ = ["STILL_LIFES"]

_ARC_VIEWS = 80
_ARC_DEGREES = 140.0
_STILL_LIFE = (0.0, -0.55, 0.0)
_PROJECTOR = aside(0, 3.7, _STILL_LIFE, 1.0, 34)
_GRID_STEP = 0.22
# Radii and heights of a vase, open above.
_VASE = [(0.2 + 0.14 * np.sin(5.2 * h) * (1 - 0.5 * h), 1.1 * h) for h in np.linspace(0.0, 1.0, 16)]


def _foreshortened() -> dict[str, Any]:
    """A long floor with print on it, and a pillar with rings, at grazing angles."""
    text = ["LIGHT ", "RETURN", "ALONG ", "EITHER", "SIDE  "]
    rings = np.repeat(checks(24, 1, (0.5, 0.1, 0.08), (0.85, 0.83, 0.75)), 4, axis=1)
    return {
        "type": "scene",
        "floor": sheet((0, -1, -0.6), (1.1, 0, 0), (0, 0, -1.8), painted(lettering(text))),
        "wall": sheet((-1.1, 0.5, -0.6), (0, 0, -1.8), (0, 1.5, 0), painted(checks(15, 40))),
        "right": sheet((1.1, 0.5, -0.6), (0, 0, 1.8), (0, 1.5, 0), matt(0.4, 0.5, 0.6)),
        "back": sheet((0, 0.5, -2.4), (1.1, 0, 0), (0, 1.5, 0), matt(0.6, 0.6, 0.6)),
        "pillar": pillar((0.6, -1, -1.0), 2.4, 0.2, painted(rings)),
    }


def _blind() -> dict[str, Any]:
    """Slats before a window of colour: light passes between them, and from one to the next."""
    spots = blots(96, 3, [(0.75, 0.7, 0.5), (0.6, 0.1, 0.05), (0.05, 0.3, 0.5), (0.1, 0.4, 0.1)])
    tilt = np.radians(38)
    slats = {
        f"slat_{k}": sheet(
            (0, float(y), 0.1),
            (0.85, 0, 0),
            (0, 0.085 * np.sin(tilt), -0.085 * np.cos(tilt)),
            matt(0.5, 0.49, 0.45),
        )
        for k, y in enumerate(np.linspace(-0.8, 0.8, 13))
    }
    return walls() | slats | {"back": sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), painted(spots))}


def _still_life() -> dict[str, Any]:
    spots = blots(128, 7, [(0.75, 0.72, 0.62), (0.5, 0.35, 0.2), (0.2, 0.3, 0.45)])
    return {
        "type": "scene",
        "table": sheet((0, -1, 0), (1.9, 0, 0), (0, 0, -1.5), painted(spots)),
        "vase": turned((-0.35, -1, -0.2), _VASE, {"type": "twosided", "m": matt(0.2, 0.35, 0.6)}),
        "apple": ball((0.32, -0.76, 0.35), 0.24, gloss(0.15, 0.55, 0.06, 0.04)),
        "orange": ball((-0.2, -0.79, 0.55), 0.21, gloss(0.3, 0.75, 0.35, 0.03)),
        "book": box((0.5, -0.9, -0.3), (0.75, 0.2, 0.55), 20, matt(0.25, 0.45, 0.2)),
        "candle": pillar((0.55, -0.8, -0.3), 0.7, 0.1, matt(0.8, 0.75, 0.6)),
        "card": sheet(
            (-0.05, -0.62, -0.85), (0.6, 0, 0.1), (0, 0.36, 0), painted(lettering(["DUAL"]))
        ),
    }


def _grid() -> tuple[View, ...]:
    """Three rows of three views, from above and from the left, that all look at one point."""
    (_, _, distance), target = BOX_VIEW.origin, BOX_VIEW.target
    return tuple(
        View((_GRID_STEP * x, _GRID_STEP * y, distance), target, degrees=BOX_VIEW.degrees)
        for y in (1, 0, -1)
        for x in (-1, 0, 1)
    )


def _grid_box() -> dict[str, Any]:
    return walls((0.57, 0.06, 0.05), (0.12, 0.4, 0.1)) | {
        "back": sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), painted(lettering(["FAR"]))),
        "near": ball((0.3, -0.6, 0.45), 0.4, gloss(0.1, 0.5, 0.35, 0.05)),
        "block": box((-0.4, -0.55, -0.1), (0.45, 0.9, 0.45), 30, matt(0.7, 0.68, 0.64)),
    }


STILL_LIFES = (
    World(
        "foreshortened",
        "fine detail at grazing angles: print on a long floor, rings of a pillar, checks of a wall",
        _foreshortened,
        (View((0.0, -0.3, 3.4), (0, -0.4, -0.6), degrees=32),),
    ),
    World(
        "venetian_blind",
        "many thin edges, each a step of depth: slats before a painted wall",
        _blind,
        (BOX_VIEW,),
    ),
    World(
        "still_life_arc",
        "80 cameras on an arc about a still life and one projector: direct light alone, so that "
        "the matrix stays small [Fig. 3.9]",
        _still_life,
        tuple(
            aside(float(degrees), 3.7, _STILL_LIFE, 1.6, 34)
            for degrees in np.linspace(-_ARC_DEGREES / 2, _ARC_DEGREES / 2, _ARC_VIEWS)
        ),
        (_PROJECTOR,),
        bounces=1,
    ),
    World(
        "views_3x3",
        "an array of 3 x 3 coaxial views: parallax between near and far",
        _grid_box,
        _grid(),
        bounces=3,
    ),
)
