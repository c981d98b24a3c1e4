"""The rooms of the simulated scenes: surfaces in front of a coaxial rig, by the room's name."""

from __future__ import annotations

import numpy as np

from rfpipe.scenes.surfaces import Plane, Sphere, Surface, Vector, block, rotation, vector

_FARTHEST = (0.0, 0.0, 3.0)  # point on the axis where the planes of a crease or corner meet


def _wedge(opening: float, *, turned: float = 0.0, tipped: float = 0.0) -> tuple[Surface, ...]:
    """Two planes that meet at an angle: a concave edge, farthest from the camera.

    `opening` is the angle between the planes, `turned` the crease's from the vertical, clockwise
    in the image, `tipped` its inclination from the image plane, the lower end nearer; degrees.
    """
    half, turn = np.radians(opening / 2), rotation(2, turned) @ rotation(0, tipped)
    return tuple(
        Plane(name, _FARTHEST, vector(turn @ (side * np.cos(half), 0, -np.sin(half))))
        for name, side in (("left", 1), ("right", -1))
    )


def _corner() -> tuple[Surface, ...]:
    """Three planes at right angles, seen along the diagonal."""
    normal = np.sqrt([2 / 3, 0, 1 / 3]) * (1, 1, -1)
    # directions of the normals in the image, degrees
    directions = (("left", 30), ("right", 150), ("floor", -90))
    return tuple(
        Plane(name, _FARTHEST, vector(rotation(2, degrees) @ normal))
        for name, degrees in directions
    )


def _sphere_on_plane() -> tuple[Surface, ...]:
    """A sphere that rests on a floor before a wall.

    They meet at right angles in a level crease; the camera looks down on the floor.
    """
    tilt = rotation(0, 35)
    up, from_wall = -tilt[:, 1], -tilt[:, 2]
    crease, radius, gap = np.array([0.0, -0.5, 3.5]), 0.5, 0.35
    centre = crease + radius * up + (gap + radius) * from_wall + [-0.25, 0, 0]
    return (
        Plane("floor", vector(crease), vector(up)),
        Plane("wall", vector(crease), vector(from_wall)),
        Sphere("sphere", vector(centre), radius),
    )


def _coloured_room() -> tuple[Surface, ...]:
    """A room open towards the rig, with a block and a sphere on its floor.

    Its floor and ceiling end at the picture's lower and upper edge, its walls at those of a picture
    of 96 x 108 pixels, all at half the room's depth or a little more.
    """
    x, y, z = 1.125, 1.0, 3.0
    return (
        Plane("left wall", (-x, 0, 0), (1, 0, 0)),
        Plane("right wall", (x, 0, 0), (-1, 0, 0)),
        Plane("floor", (0, y, 0), (0, -1, 0)),
        Plane("ceiling", (0, -y, 0), (0, 1, 0)),
        Plane("back wall", (0, 0, z), (0, 0, -1)),
        *block("block", (-0.42, y, 2.45), side=0.5, height=1.05, turned=-30),
        Sphere("sphere", (0.42, y - 0.34, 2.3), 0.34),
    )


GEOMETRIES: dict[str, tuple[Surface, ...]] = {
    "plane": (Plane("front", (0, 0, 3), (0, 0, -1)),),
    "wedge": (
        Plane("left", (0, 0, 3), (1, 0, -1)),  # z = 3 + x
        Plane("right", (0, 0, 3), (-1, 0, -1)),  # z = 3 - x
    ),
    "wedge_30": _wedge(30),
    "wedge_120": _wedge(120),
    "tilted_wedge": _wedge(90, turned=25, tipped=20),
    "corner": _corner(),
    "sphere_on_plane": _sphere_on_plane(),
    "coloured_room": _coloured_room(),
}
"""Surfaces of each geometry, in the order in which their albedo is given, those of one name once.
Each pixel sees the nearest one; the planes bound the camera's room."""

_GREY = (0.63, 0.61, 0.59)

TINTS: dict[str, dict[str, Vector]] = {
    "coloured_room": {
        "left wall": (0.68, 0.17, 0.10),
        "right wall": (0.10, 0.41, 0.25),
        **dict.fromkeys(("floor", "ceiling", "back wall"), _GREY),
        "block": (0.66, 0.66, 0.65),
        "sphere": (0.68, 0.48, 0.15),
    },
}
"""Colours of geometries that have colours of their own: factors of the albedo, by surface."""


def names_of(geometry: str) -> tuple[str, ...]:
    """Return the names of a geometry's surfaces, the faces of a block as one."""
    return tuple(dict.fromkeys(surface.name for surface in GEOMETRIES[geometry]))
