"""The rooms of the simulated scenes: surfaces in front of a coaxial rig, by the room's name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.geometry import Plane, Surface, block
from rfpipe.scenes.pinhole import Vector
from rfpipe.scenes.visibility import Sphere

_FARTHEST = (0.0, 0.0, 3.0)  # point on the axis where the planes of a crease or corner meet


def _wedge(opening: float, *, turned: float = 0.0, tipped: float = 0.0) -> tuple[Plane, Plane]:
    """Two planes that meet at an angle: a concave edge, farthest from the camera.

    `opening` is the angle between the planes, `turned` the crease's from the vertical, clockwise
    in the image, `tipped` its inclination from the image plane, the lower end nearer; degrees.
    """
    half = np.radians(opening / 2)
    turn, tip = _rotation(2, turned), _rotation(0, tipped)
    normals = [turn @ tip @ (side * np.cos(half), 0, -np.sin(half)) for side in (1, -1)]
    left, right = (_plane(name, n) for name, n in zip(("left", "right"), normals, strict=True))
    return left, right


def _corner() -> tuple[Plane, ...]:
    """Three planes at right angles, seen along the diagonal."""
    planes = []
    # directions of the normals in the image, degrees
    for name, degrees in (("left", 30), ("right", 150), ("floor", -90)):
        angle = np.radians(degrees)
        across = np.sqrt(2 / 3) * np.array([np.cos(angle), np.sin(angle), 0])
        planes.append(_plane(name, across - [0, 0, np.sqrt(1 / 3)]))
    return tuple(planes)


def _sphere_on_plane() -> tuple[Surface, ...]:
    """A sphere that rests on a floor before a wall.

    They meet at right angles in a level crease; the camera looks down on the floor.
    """
    sine, cosine = (float(f(np.radians(35))) for f in (np.sin, np.cos))
    up, from_wall = np.array([0, -cosine, -sine]), np.array([0, sine, -cosine])
    crease, radius, gap = np.array([0.0, -0.5, 3.5]), 0.5, 0.35
    centre = crease + radius * up + (gap + radius) * from_wall + [-0.25, 0, 0]
    return (
        Plane("floor", _vector(crease), _vector(up)),
        Plane("wall", _vector(crease), _vector(from_wall)),
        Sphere("sphere", _vector(centre), radius),
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


def _rotation(axis: int, degrees: float) -> NDArray[np.float64]:
    """Matrix that rotates by some degrees around axis 0 (x) or 2 (z)."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    matrix = np.eye(3)
    plane = [i for i in range(3) if i != axis]
    matrix[np.ix_(plane, plane)] = [[cosine, -sine], [sine, cosine]]
    return matrix


def _plane(name: str, normal: NDArray[np.float64]) -> Plane:
    """A plane through the farthest point."""
    return Plane(name, _FARTHEST, _vector(normal))


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


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

TINTS: dict[str, dict[str, Vector]] = {
    "coloured_room": {
        "left wall": (0.68, 0.17, 0.10),
        "right wall": (0.10, 0.41, 0.25),
        "floor": (0.63, 0.61, 0.59),
        "ceiling": (0.63, 0.61, 0.59),
        "back wall": (0.63, 0.61, 0.59),
        "block": (0.66, 0.66, 0.65),
        "sphere": (0.68, 0.48, 0.15),
    },
}
"""Colours of geometries that have colours of their own: factors of the albedo, by surface."""


def names_of(geometry: str) -> tuple[str, ...]:
    """Return the names of a geometry's surfaces, the faces of a block as one."""
    return tuple(dict.fromkeys(surface.name for surface in GEOMETRIES[geometry]))
