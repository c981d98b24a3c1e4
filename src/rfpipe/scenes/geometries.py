"""Surfaces of the simulated scenes, by name, and their albedo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
from rfpipe.scenes.surfaces import Plane, Sphere, Surface, Vector, block, rotation, vector

_APEX = (0.0, 0.0, 3.0)  # intersection of the planes of a wedge or corner, on the optical axis


def _wedge(opening: float, *, turned: float = 0.0, tipped: float = 0.0) -> tuple[Surface, ...]:
    """Two planes that meet in a concave edge, which is farthest from the camera.

    `opening` is the angle between the planes, `turned` the edge's angle to the vertical, clockwise
    in the image, `tipped` its angle to the image plane, with the lower end nearer; in degrees.
    """
    half, turn = np.radians(opening / 2), rotation(2, turned) @ rotation(0, tipped)
    return tuple(
        Plane(name, _APEX, vector(turn @ (side * np.cos(half), 0, -np.sin(half))))
        for name, side in (("left", 1), ("right", -1))
    )


def _corner() -> tuple[Surface, ...]:
    """Three planes at right angles, seen along the diagonal."""
    normal = np.sqrt([2 / 3, 0, 1 / 3]) * (1, 1, -1)
    # directions of the normals in the image, degrees
    directions = (("left", 30), ("right", 150), ("floor", -90))
    return tuple(
        Plane(name, _APEX, vector(rotation(2, degrees) @ normal)) for name, degrees in directions
    )


def _sphere_on_plane() -> tuple[Surface, ...]:
    """A sphere on a floor in front of a wall.

    Floor and wall meet at right angles; the camera looks down on the floor.
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
    """A room, open towards the rig, with a block and a sphere on its floor.

    In a picture of 96 x 108 pixels, floor, ceiling and walls reach the edges of the picture, at
    half of the room's depth or slightly more.
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
"""Surfaces of each geometry, in the order of settings; surfaces of the same name count once.

Each pixel sees the nearest surface; planes enclose the camera.
"""

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
"""Colours of the surfaces of some geometries: factors of the albedo in RGB."""


def surface_names(geometry: str) -> tuple[str, ...]:
    """List the names of a geometry's surfaces; the faces of a block have the same name."""
    return tuple(dict.fromkeys(surface.name for surface in GEOMETRIES[geometry]))


WHITE = 0.8
PAPER = 0.85
INK = 0.15

# Default factors of the albedo of each surface in RGB: surfaces differ in colour, the middle
# channel is that of a grey scene, and no albedo is close to 1.
SURFACE_TINTS = ((1.04, 1.0, 0.92), (0.94, 1.0, 1.05), (1.08, 1.0, 1.02))

# Layout of a printed page, in pixels.
_LETTER_HEIGHT = 7
_LEADING = 9  # distance of lines of text
_LETTER_WIDTHS = (4, 6)  # bounds, inclusive
_WORD_LENGTHS = (2, 7)  # letters


def printed_page(shape: tuple[int, int], seed: int, page: int = 0) -> NDArray[np.bool_]:
    """Draw lines of words of letter-like strokes: bool (H, W), True for ink.

    Strokes are one to two pixels wide. `page` selects different pages of the same seed.
    """
    random = generator(seed, page)
    # margins are wide enough for words that begin at the edge
    margin, word = _LETTER_HEIGHT, _WORD_LENGTHS[1] * (_LETTER_WIDTHS[1] + 1)
    height, width = shape[0] + margin, shape[1] + margin
    ink = np.zeros((height + margin, width + word), dtype=np.bool_)
    for top in range(margin + int(random.integers(-_LETTER_HEIGHT, 1)), height, _LEADING):
        x = margin + int(random.integers(-_LETTER_WIDTHS[1], 1))
        while x < width:
            for _ in range(random.integers(_WORD_LENGTHS[0], _WORD_LENGTHS[1] + 1)):
                letter = _letter(random)
                ink[top : top + _LETTER_HEIGHT, x : x + letter.shape[1]] |= letter
                x += letter.shape[1] + 1
            x += int(random.integers(1, 4))
    return ink[margin:height, margin:width]


def _letter(random: np.random.Generator) -> NDArray[np.bool_]:
    """Draw a vertical stroke on the left and two or three further strokes, as in a capital."""
    width = int(random.integers(_LETTER_WIDTHS[0], _LETTER_WIDTHS[1] + 1))
    letter = np.zeros((_LETTER_HEIGHT, width), dtype=np.bool_)
    letter[:, : random.integers(1, 3)] = True
    rows = np.arange(_LETTER_HEIGHT)
    slant = 1 + rows * (width - 2) // (_LETTER_HEIGHT - 1)
    for stroke in random.choice(6, size=random.integers(2, 4), replace=False):
        if stroke < 3:  # a horizontal bar at the top, in the middle or at the bottom
            letter[stroke * (_LETTER_HEIGHT - 1) // 2] = True
        elif stroke == 3:
            letter[:, -1] = True
        else:
            letter[rows, slant if stroke == 4 else slant[::-1]] = True
    return letter


def surface_albedo(
    kind: str,
    shape: tuple[int, int],
    channels: int,
    seed: int,
    surface: int,
    tint: tuple[float, float, float] | None = None,
) -> NDArray[np.float64]:
    """Albedo of one surface over the pixels of an image or its texels: float64 (H, W, C).

    Parameters
    ----------
    kind
        ``"white"`` or ``"texture"``.
    channels
        1 (grey) or 3 (RGB, tinted).
    surface
        Index of the surface, which selects its page and its tint.
    tint
        Factors of the albedo in RGB, instead of those in `SURFACE_TINTS`; a grey surface uses the
        middle one.
    """
    grey = np.full(shape, {"white": WHITE, "texture": PAPER}[kind])
    if kind == "texture":
        grey[printed_page(shape, seed, surface)] = INK
    factors = np.array(tint or SURFACE_TINTS[surface % len(SURFACE_TINTS)])
    albedo: NDArray[np.float64] = grey[..., None] * (factors if channels > 1 else factors[1:2])
    return albedo
