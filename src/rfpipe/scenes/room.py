"""The corner of a room with things standing in it, for an array of views [thesis Fig. 5.8].

Two walls that meet at a right angle and a floor; in front of them a box, a poster and a card in
the air. They hide parts of the walls from some views, throw shadows that move with the light, and
reflect light onto each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rfpipe.scenes.panels import Panel
from rfpipe.scenes.pinhole import Vector
from rfpipe.scenes.textures import require_kinds
from rfpipe.scenes.views import DISTANCE

__all__ = ["ROOM_SURFACES", "room_panels"]

ROOM_SURFACES = ("left wall", "right wall", "floor")
"""The surfaces of the room that may be white or textured; all others are textured."""

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
    require_kinds(surfaces, "room", ROOM_SURFACES)
    left, right, floor = surfaces
    middle = _FLOOR + 0.1 - _WALL  # a little of the walls goes below the floor: no gap
    below = (0, _FLOOR, _CORNER - _WALL + 0.1)
    return (
        _panel("left wall", (0, middle, _CORNER), (_WALL, _WALL), 45, left, encloses=True),
        _panel("right wall", (0, middle, _CORNER), (_WALL, _WALL), -45, right, encloses=True),
        _panel("floor", below, (_WALL, _WALL), 0, floor, lies=True, encloses=True),
        *_box("box", (-0.28, _FLOOR, 0.02), side=0.42, height=0.5, turned=32),
        _panel("poster", (0.42, _FLOOR - 0.3, -0.12), (0.26, 0.3), -20, "texture"),
        _panel("card", (-0.38, -0.42, -0.1), (0.22, 0.15), 15, "texture", lies=True),
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
        sides.append(_panel(name, centre, (half, height / 2), angle, "texture"))
    lid = _panel(name, (x, y - height, z), (half, half), turned, "texture", lies=True)
    return (*sides, lid)


def _panel(
    name: str,
    centre: Vector,
    half: tuple[float, float],
    turned: float,
    surface: str,
    *,
    lies: bool = False,
    encloses: bool = False,
) -> Panel:
    """A panel as the views see it, looking down: half its width, and its height or depth.

    One that stands faces the views turned by 0 degrees, and right by 90; one that lies faces up.
    """
    sine, cosine = (float(f(np.radians(turned))) for f in (np.sin, np.cos))
    across = _seen((half[0] * cosine, 0.0, half[0] * sine))
    down = _seen((half[1] * sine, 0.0, -half[1] * cosine) if lies else (0.0, half[1], 0.0))
    x, y, z = _seen(centre)
    return Panel(name, (x, y, z + DISTANCE), across, down, surface, _TINTS[name], encloses)


def _seen(vector: Vector) -> Vector:
    """Turn a vector of the room's frame into the views'."""
    sine, cosine = (float(f(np.radians(_LOOKING_DOWN))) for f in (np.sin, np.cos))
    x, y, z = vector
    return (x, y * cosine - z * sine, y * sine + z * cosine)
