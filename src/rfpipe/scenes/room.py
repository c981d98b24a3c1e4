"""The corner of a room with things standing in it, for an array of views [thesis Fig. 5.8].

Two walls that meet at a right angle and a floor; in front of them a box, a poster and a card in
the air. They hide parts of the walls from some views, throw shadows that move with the light, and
reflect light onto each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rfpipe.scenes.furniture import block, lying, standing
from rfpipe.scenes.geometry import Rectangle, Vector
from rfpipe.scenes.panels import Panel
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
    middle = _FLOOR + 0.1 - _WALL  # a little of the walls goes below the floor: no gap
    below = (0, _FLOOR, _CORNER - _WALL + 0.1)
    walls = (
        standing("left wall", (0, middle, _CORNER), (_WALL, _WALL), 45),
        standing("right wall", (0, middle, _CORNER), (_WALL, _WALL), -45),
        lying("floor", below, (_WALL, _WALL), 0),
    )
    things = (
        *block("box", (-0.28, _FLOOR, 0.02), side=0.42, height=0.5, turned=32),
        standing("poster", (0.42, _FLOOR - 0.3, -0.12), (0.26, 0.3), -20),
        lying("card", (-0.38, -0.42, -0.1), (0.22, 0.15), 15),
    )
    return (
        *(_seen(wall, kind, encloses=True) for wall, kind in zip(walls, surfaces, strict=True)),
        *(_seen(thing, "texture") for thing in things),
    )


def _seen(rectangle: Rectangle, surface: str, *, encloses: bool = False) -> Panel:
    """Return a panel as the views see it, looking down."""
    x, y, z = _tipped(rectangle.centre)
    across, down = _tipped(rectangle.edge_u), _tipped(rectangle.edge_v)
    name = rectangle.name
    return Panel(name, (x, y, z + DISTANCE), across, down, surface, _TINTS[name], encloses)


def _tipped(vector: Vector) -> Vector:
    """Turn a vector of the room's frame into the views'."""
    sine, cosine = (float(f(np.radians(_LOOKING_DOWN))) for f in (np.sin, np.cos))
    x, y, z = vector
    return (x, y * cosine - z * sine, y * sine + z * cosine)
