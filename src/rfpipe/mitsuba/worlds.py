"""Physically based scenes by name; docs/scenes.md describes the purpose of each.

Lengths are in scene units: x to the right, y up, z towards the viewer. Each scene is a function
that returns its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rfpipe.mitsuba.parts import (
    SceneDict,
    Vector,
    ball,
    body,
    both_sides,
    box,
    checks,
    discs,
    glass,
    gloss,
    lathe,
    lettering,
    matt,
    metal,
    mirror,
    pillar,
    sheet,
    textured,
)
from rfpipe.mitsuba.views import View
from rfpipe.mitsuba.world import World

WORLDS: dict[str, World] = {}
"""All scenes by name."""

_WHITE, _RED, _GREEN = (0.75, 0.72, 0.68), (0.57, 0.06, 0.05), (0.12, 0.4, 0.1)


def view(origin: Vector, target: Vector, degrees: float, up: Vector = (0, 1, 0)) -> View:
    """A view with a horizontal field of view in degrees."""
    return View.model_validate({"origin": origin, "target": target, "up": up, "degrees": degrees})


def aside(degrees: float, distance: float, target: Vector, rise: float, field: float) -> View:
    """A view rotated to the right about the vertical axis through its target.

    `distance` is measured from that axis, `rise` is the height above the target, and `field` the
    field of view in degrees.
    """
    turn = float(np.radians(degrees))
    x, y, z = target
    origin = x + distance * np.sin(turn), y + rise, z + distance * np.cos(turn)
    return view([float(coordinate) for coordinate in origin], target, field)


def _world(
    cameras: Sequence[View],
    projectors: Sequence[View] | None = None,
    *,
    bounces: int = 6,
    caustics: bool = False,
) -> Callable[[Callable[[], SceneDict]], None]:
    """Register a scene under its function's name, with its rig and tracing parameters."""

    def add(build: Callable[[], SceneDict]) -> None:
        name = build.__name__
        projector_views = None if projectors is None else tuple(projectors)
        WORLDS[name] = World(
            name,
            lambda: {"type": "scene", **build()},
            tuple(cameras),
            projector_views,
            bounces,
            caustics,
        )

    return add


def _walls(
    left_colour: tuple[float, ...] = _WHITE, right_colour: tuple[float, ...] = _WHITE
) -> SceneDict:
    """The five walls of a box from -1 to 1, open towards the viewer."""
    white = matt(*_WHITE)
    return {
        "floor": sheet((0, -1, 0), (1, 0, 0), (0, 0, -1), white),
        "ceiling": sheet((0, 1, 0), (1, 0, 0), (0, 0, 1), white),
        "back": sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), white),
        "left": sheet((-1, 0, 0), (0, 0, -1), (0, 1, 0), matt(*left_colour)),
        "right": sheet((1, 0, 0), (0, 0, 1), (0, 1, 0), matt(*right_colour)),
    }


_BOX_VIEW = view((0, 0, 3.9), (0, 0, 0), 39.3)  # before the open side of the walls


@_world([_BOX_VIEW])
def red_wall_box() -> SceneDict:
    """Colour bleeding in a diffuse cavity."""
    return _walls(_RED)


@_world([_BOX_VIEW])
def two_blocks() -> SceneDict:
    """Shadows and occlusion between matt surfaces."""
    white = matt(*_WHITE)
    return _walls(_RED, _GREEN) | {
        "tall": box((-0.33, -0.4, -0.28), (0.6, 1.2, 0.6), 18, white),
        "short": box((0.33, -0.7, 0.38), (0.6, 0.6, 0.6), -17, white),
    }


@_world([_BOX_VIEW], [aside(35, 1.6, (0, -0.1, 0), 0.35, 84)])  # in front of the open side
def two_blocks_aside() -> SceneDict:
    """The scene two_blocks with shadows visible to the camera: entries without direct light."""
    return WORLDS["two_blocks"].build()


@_world([view((0, 0.5, 3.9), (0, -0.28, 0), 33)])
def glossy_metal() -> SceneDict:
    """Highlights and blurred reflections: gloss and rough metal in a box."""
    return _walls() | {
        "floor": sheet((0, -1, 0), (1, 0, 0), (0, 0, -1), textured(checks(8, 8))),
        "plastic": ball((-0.5, -0.62, 0.25), 0.38, gloss(0.08, 0.5, 0.05, 0.04)),
        "copper": ball((0.42, -0.65, 0.4), 0.35, metal(0.3, 0.93, 0.6, 0.45)),
        "steel": box((0.05, -0.45, -0.45), (0.55, 1.1, 0.4), 28, metal(0.25, 0.75, 0.76, 0.78)),
    }


@_world([view((0, 0.4, 3.9), (0.05, -0.4, 0), 31)], caustics=True)
def mirror_beside() -> SceneDict:
    """A mirror beside a block: distant pixels see the same surface, and a caustic falls on it."""
    letters = textured(lettering(["EG", "SR"]))
    return {
        "floor": sheet((0, -1, 0), (1.6, 0, 0), (0, 0, -1.6), textured(checks(12, 12))),
        "back": sheet((0, 0, -1.6), (1.6, 0, 0), (0, 1, 0), matt(0.6, 0.62, 0.66)),
        "mirror": sheet((0.75, -0.4, -0.2), (0.4, 0, 0.37), (0, 0.6, 0), mirror()),
        "block": box((-0.4, -0.55, 0.1), (0.9, 0.9, 0.5), 53, matt(0.1, 0.25, 0.5)),
        "letters": sheet((-0.196, -0.55, 0.253), (0.25, 0, -0.333), (0, 0.4, 0), letters),
        "ball": ball((0.2, -0.8, 0.6), 0.2, matt(0.65, 0.25, 0.05)),
    }


@_world(
    [view((-0.1, 4.0, 0.25), (-0.1, -0.5, 0.15), 30, up=(0, 0, -1))],
    [aside(8, 4.2, (-0.05, -0.55, 0), 0.7, 32)],
    caustics=True,
)
def right_angles() -> SceneDict:
    """A box in front of a mirror, seen edge-on by the camera, not by the projector [Fig. 3.10]."""
    letters = textured(lettering(["EGSR", "DUAL"], ink=(0.5, 0.05, 0.05)))
    return {
        "floor": sheet((0, -1, 0), (2, 0, 0), (0, 0, -2), matt(0.65, 0.62, 0.55)),
        "back": sheet((0, -0.3, -1.3), (1.3, 0, 0), (0, 0.7, 0), matt(0.5, 0.55, 0.65)),
        "mirror": sheet((-0.85, -0.5, 0.05), (0.3, 0.0, -0.6), (0.08, 0.5, 0.04), mirror()),
        "block": box((0.25, -0.7, 0.15), (0.6, 0.6, 0.6), 25, matt(0.6, 0.45, 0.2)),
        "lid": sheet((0.25, -0.395, 0.15), (0.26, 0, -0.12), (-0.12, 0, -0.26), letters),
        "post": pillar((0.85, -1, -0.6), 0.9, 0.14, matt(0.15, 0.45, 0.2)),
        "knob": ball((0.85, -0.06, -0.6), 0.16, matt(0.6, 0.5, 0.15)),
        "ball": ball((-0.25, -0.82, 0.75), 0.18, matt(0.6, 0.12, 0.1)),
    }


def _table() -> SceneDict:
    """A floor with a wall behind it."""
    return {
        "floor": sheet((0, -1, 0), (3, 0, 0), (0, 0, -3), matt(0.72, 0.7, 0.66)),
        "back": sheet((0, 0.4, -1.3), (3, 0, 0), (0, 1.4, 0), matt(0.45, 0.5, 0.6)),
    }


_TABLE_VIEW = view((-0.25, 1.7, 3.6), (-0.25, -0.55, 0), 33)


@_world([_TABLE_VIEW], [aside(50, 3.3, (0.0, -0.6, 0), 1.9, 33)], bounces=10, caustics=True)
def glass_ball() -> SceneDict:
    """A glass ball with a caustic that the camera sees directly."""
    return _table() | {
        "ball": ball((0.15, -0.55, 0), 0.44, glass()),
        "block": box((-0.85, -0.8, -0.75), (0.4, 0.4, 0.4), 20, matt(0.6, 0.2, 0.1)),
    }


@_world([_TABLE_VIEW], [aside(60, 3.5, (-0.05, -0.5, 0), 0.9, 33)], bounces=10, caustics=True)
def bottle() -> SceneDict:
    """A bottle of water: caustics, and refraction in the dual image [Fig. 3.2, 3.6]."""
    shoulder = [
        (0.175 + 0.095 * np.cos(t), 0.75 + 0.3 * np.sin(t / 2)) for t in np.linspace(0.4, np.pi, 8)
    ]
    foot = [(0, 0), (0.24, 0), (0.27, 0.03), *((0.27, h) for h in np.linspace(0.1, 0.75, 6))]
    neck = [(0.08, 1.12), (0.08, 1.3), (0.07, 1.32), (0, 1.32)]  # radii and heights, closed
    return _table() | {
        "bottle": lathe((0.2, -0.999, 0.1), [*foot, *shoulder, *neck], glass(1.4)),
        "block": box((-0.85, -0.8, -0.75), (0.4, 0.4, 0.4), 20, matt(0.15, 0.35, 0.6)),
    }


@_world([view((0, 1.9, 3.2), (0, -0.8, 0), 32)], bounces=10, caustics=True)
def glass_and_ring() -> SceneDict:
    """Caustics within a mirror ring, and a block of glass with a chessboard behind it.

    A glass ball would be a retroreflector, whose focus is far brighter than all other light.
    """
    return _table() | {
        "ring": pillar((-0.5, -0.999, 0.1), 0.32, 0.5, both_sides(mirror())),
        "block": box((0.5, -0.74, 0.15), (0.55, 0.5, 0.4), 25, glass()),
        "check": sheet((0.5, -0.3, -1.29), (0.6, 0, 0), (0, 0.3, 0), textured(checks(3, 6))),
    }


@_world([_TABLE_VIEW], bounces=48)
def translucent() -> SceneDict:
    """Translucent bodies of marble and soap: indirect light outside the lit area."""
    marble = body(ball((-0.3, -0.52, 0.1), 0.46, {}), 0.08, 0.0, 0.98, 0.95, 0.88)
    soap = body(box((0.5, -0.72, 0.35), (0.5, 0.52, 0.5), -25, {}), 0.12, 0.5, 0.85, 0.97, 0.9)
    return _table() | {"marble": marble, "soap": soap}


@_world([aside(turn, 3.6, (0, -0.05, 0), 0.6, 24) for turn in (0, 120)], bounces=48)
def sweets() -> SceneDict:
    """Translucent balls in a tumbler with weak reflections and no refraction [Fig. 5.6]."""
    red, green, yellow = (0.97, 0.35, 0.3), (0.45, 0.95, 0.4), (0.97, 0.9, 0.4)
    orange, white = (0.97, 0.65, 0.25), (0.96, 0.95, 0.92)
    places = (  # x, height above the floor, z, radius, colour
        (-0.18, 0.22, 0.13, 0.2, red),
        (0.21, 0.21, 0.08, 0.19, green),
        (0.0, 0.21, -0.25, 0.19, yellow),
        (0.02, 0.53, 0.17, 0.2, orange),
        (-0.2, 0.56, -0.15, 0.19, white),
        (0.22, 0.56, -0.17, 0.2, red),
        (-0.16, 0.87, 0.1, 0.2, green),
        (0.2, 0.9, 0.09, 0.18, white),
        (0.0, 0.92, -0.24, 0.19, orange),
    )
    letters = textured(lettering(["EGSR"]))
    sheen = {"type": "mask", "opacity": 0.06, "sheen": both_sides(metal(0.1, 0.9))}
    return {
        "floor": sheet((0, -0.7, 0), (1.4, 0, 0), (0, 0, -1.4), matt(0.5, 0.48, 0.45)),
        "tumbler": pillar((0, -0.699, 0), 1.35, 0.47, sheen),
        "letters": sheet((-0.02, -0.5, 0.6), (0.32, 0, 0), (0, 0.16, -0.06), letters),
    } | {
        f"sweet_{k}": body(ball((x, height - 0.69, z), radius, {}), 0.09, 0.3, *colour)
        for k, (x, height, z, radius, colour) in enumerate(places)
    }


@_world([view((0.0, -0.3, 3.4), (0, -0.4, -0.6), 32)])
def foreshortened() -> SceneDict:
    """Fine texture at grazing angles on a long floor, a pillar and a wall."""
    text = ["LIGHT ", "RETURN", "ALONG ", "EITHER", "SIDE  "]
    rings = np.repeat(checks(24, 1, (0.5, 0.1, 0.08), (0.85, 0.83, 0.75)), 4, axis=1)
    return {
        "floor": sheet((0, -1, -0.6), (1.1, 0, 0), (0, 0, -1.8), textured(lettering(text))),
        "wall": sheet((-1.1, 0.5, -0.6), (0, 0, -1.8), (0, 1.5, 0), textured(checks(15, 40))),
        "right": sheet((1.1, 0.5, -0.6), (0, 0, 1.8), (0, 1.5, 0), matt(0.4, 0.5, 0.6)),
        "back": sheet((0, 0.5, -2.4), (1.1, 0, 0), (0, 1.5, 0), matt(0.6, 0.6, 0.6)),
        "pillar": pillar((0.6, -1, -1.0), 2.4, 0.2, textured(rings)),
    }


@_world([_BOX_VIEW])
def venetian_blind() -> SceneDict:
    """Many thin depth edges: slats in front of a coloured wall."""
    spots = discs(96, 3, [(0.75, 0.7, 0.5), (0.6, 0.1, 0.05), (0.05, 0.3, 0.5), (0.1, 0.4, 0.1)])
    tilt = np.radians(38)
    slat = (0.85, 0, 0), (0, 0.085 * np.sin(tilt), -0.085 * np.cos(tilt)), matt(0.5, 0.49, 0.45)
    slats = {
        f"slat_{k}": sheet((0, float(y), 0.1), *slat)
        for k, y in enumerate(np.linspace(-0.8, 0.8, 13))
    }
    return _walls() | slats | {"back": sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), textured(spots))}


_STILL_LIFE = (0.0, -0.55, 0.0)


@_world(
    [aside(float(turn), 3.7, _STILL_LIFE, 1.6, 34) for turn in np.linspace(-70, 70, 80)],
    [aside(0, 3.7, _STILL_LIFE, 1.0, 34)],
    bounces=1,  # keeps the matrix small
)
def still_life_arc() -> SceneDict:
    """Relighting from 80 positions on an arc of 140 degrees, with soft shadows [Fig. 3.9]."""
    spots = discs(128, 7, [(0.75, 0.72, 0.62), (0.5, 0.35, 0.2), (0.2, 0.3, 0.45)])
    vase = [(0.2 + 0.14 * np.sin(5.2 * h) * (1 - 0.5 * h), 1.1 * h) for h in np.linspace(0, 1, 16)]
    dual = textured(lettering(["DUAL"]))
    return {
        "table": sheet((0, -1, 0), (1.9, 0, 0), (0, 0, -1.5), textured(spots)),
        "vase": lathe((-0.35, -1, -0.2), vase, both_sides(matt(0.2, 0.35, 0.6))),
        "apple": ball((0.32, -0.76, 0.35), 0.24, gloss(0.15, 0.55, 0.06, 0.04)),
        "orange": ball((-0.2, -0.79, 0.55), 0.21, gloss(0.3, 0.75, 0.35, 0.03)),
        "book": box((0.5, -0.9, -0.3), (0.75, 0.2, 0.55), 20, matt(0.25, 0.45, 0.2)),
        "candle": pillar((0.55, -0.8, -0.3), 0.7, 0.1, matt(0.8, 0.75, 0.6)),
        "card": sheet((-0.05, -0.62, -0.85), (0.6, 0, 0.1), (0, 0.36, 0), dual),
    }


@_world(
    [view((0.22 * x, 0.22 * y, 3.9), (0, 0, 0), 39.3) for y in (1, 0, -1) for x in (-1, 0, 1)],
    bounces=3,
)
def views_3x3() -> SceneDict:
    """Parallax between near and far: 3 x 3 views, from the top left, row by row."""
    return _walls(_RED, _GREEN) | {
        "back": sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), textured(lettering(["FAR"]))),
        "near": ball((0.3, -0.6, 0.45), 0.4, gloss(0.1, 0.5, 0.35, 0.05)),
        "block": box((-0.4, -0.55, -0.1), (0.45, 0.9, 0.45), 30, matt(0.7, 0.68, 0.64)),
    }
