"""The corner of a room with things standing in it, for an array of views [thesis Fig. 5.8].

Two walls that meet at a right angle and a floor; in front of them a box, a poster and a card in
the air. They hide parts of the walls from some views, throw shadows that move with the light, and
reflect light onto each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rfpipe.errors import InputError
from rfpipe.scenes.panels import Panel
from rfpipe.scenes.views import DISTANCE

__all__ = ["ROOM_SURFACES", "room_panels"]

ROOM_SURFACES = ("left wall", "right wall", "floor")
"""The surfaces of the room that may be white or textured; all others are textured."""

Vector = tuple[float, float, float]

# The room stands in a frame of its own: x to the right, y down, z away, and its origin where the
# views look; these look down at it. Lengths in scene units, angles in degrees.
_LOOKING_DOWN = 35
_FLOOR = 0.42  # y
_CORNER = 0.75  # z of the edge between the walls
_WALL = 3.0  # half the sides of walls and floor: more than the views see
_TINTS: dict[str, Vector] = {
    "left wall": (1.05, 0.72, 0.55),
    "right wall": (0.62, 0.85, 1.05),
    "floor": (1.0, 0.98, 0.94),
    "box": (0.70, 1.0, 0.55),
    "poster": (1.06, 1.0, 0.60),
    "card": (1.06, 0.78, 0.92),
}


def room_panels(surfaces: Sequence[str]) -> tuple[Panel, ...]:
    """Furnish the room.

    Parameters
    ----------
    surfaces
        ``"white"`` or ``"texture"`` for each of `ROOM_SURFACES`.

    Returns
    -------
    tuple of Panel
        In scene units, as the array of views sees them.

    Raises
    ------
    InputError
        For another number of surfaces, or an unknown one.
    """
    if len(surfaces) != len(ROOM_SURFACES) or not set(surfaces) <= {"white", "texture"}:
        raise InputError(
            f"surfaces {tuple(surfaces)} of geometry 'room': expected {len(ROOM_SURFACES)} "
            f"({', '.join(ROOM_SURFACES)}), each 'white' or 'texture'"
        )
    left, right, floor = surfaces
    middle = _FLOOR + 0.1 - _WALL  # a little of the walls goes below the floor: no gap
    return (
        _upright("left wall", (0, middle, _CORNER), (_WALL, _WALL), 45, left, encloses=True),
        _upright("right wall", (0, middle, _CORNER), (_WALL, _WALL), -45, right, encloses=True),
        _level(
            "floor", (0, _FLOOR, _CORNER - _WALL + 0.1), (_WALL, _WALL), 0, floor, encloses=True
        ),
        *_box("box", (-0.28, _FLOOR, 0.02), side=0.42, height=0.5, turned=32),
        _upright("poster", (0.42, _FLOOR - 0.3, -0.12), (0.26, 0.3), -20, "texture"),
        _level("card", (-0.38, -0.42, -0.1), (0.22, 0.15), 15, "texture"),
    )


def _box(
    name: str, foot: Vector, *, side: float, height: float, turned: float
) -> tuple[Panel, ...]:
    """A box on the floor: its four sides and its lid."""
    x, y, z = foot
    half = side / 2
    sides = []
    for angle in (turned, turned - 90, turned + 90, turned + 180):
        sine, cosine = np.sin(np.radians(angle)), np.cos(np.radians(angle))
        centre = (x + half * float(sine), y - height / 2, z - half * float(cosine))
        sides.append(_upright(name, centre, (half, height / 2), angle, "texture"))
    return (*sides, _level(name, (x, y - height, z), (half, half), turned, "texture"))


def _upright(
    name: str,
    centre: Vector,
    half: tuple[float, float],
    turned: float,
    surface: str,
    *,
    encloses: bool = False,
) -> Panel:
    """A panel that stands: half its width and height; 0 faces the views, 90 faces right."""
    sine, cosine = np.sin(np.radians(turned)), np.cos(np.radians(turned))
    across = (half[0] * float(cosine), 0.0, half[0] * float(sine))
    return _panel(name, centre, across, (0.0, half[1], 0.0), surface, encloses)


def _level(
    name: str,
    centre: Vector,
    half: tuple[float, float],
    turned: float,
    surface: str,
    *,
    encloses: bool = False,
) -> Panel:
    """A panel that lies and faces up: half its width and depth."""
    sine, cosine = np.sin(np.radians(turned)), np.cos(np.radians(turned))
    across = (half[0] * float(cosine), 0.0, half[0] * float(sine))
    nearer = (half[1] * float(sine), 0.0, -half[1] * float(cosine))
    return _panel(name, centre, across, nearer, surface, encloses)


def _panel(
    name: str, centre: Vector, edge_u: Vector, edge_v: Vector, surface: str, encloses: bool
) -> Panel:
    """A panel of the room as the views see it, looking down."""
    x, y, z = _seen(centre)
    return Panel(
        name, (x, y, z + DISTANCE), _seen(edge_u), _seen(edge_v), surface, _TINTS[name], encloses
    )


def _seen(vector: Vector) -> Vector:
    """Turn a vector of the room's frame into the views'."""
    sine, cosine = (float(f(np.radians(_LOOKING_DOWN))) for f in (np.sin, np.cos))
    x, y, z = vector
    return (x, y * cosine - z * sine, y * sine + z * cosine)
