"""The rooms of the simulated scenes, by name: surfaces before a coaxial rig, and their albedo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
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


WHITE = 0.8
PAPER = 0.85
INK = 0.15

# Colour of each surface of an RGB scene: factors of its albedo around one, so that the surfaces
# differ in colour, the middle channel is the grey scene's and no albedo comes near 1.
SURFACE_TINTS = ((1.04, 1.0, 0.92), (0.94, 1.0, 1.05), (1.08, 1.0, 1.02))

# A printed page at the run's resolution, in pixels.
_LETTER_HEIGHT = 7
_LEADING = 9  # from one line of text to the next
_LETTER_WIDTHS = (4, 6)  # bounds, inclusive
_WORD_LENGTHS = (2, 7)  # letters


def printed_page(shape: tuple[int, int], seed: int, page: int = 0) -> NDArray[np.bool_]:
    """Lines of words of letter-like strokes, one to two pixels wide: bool (H, W), True for ink.

    Pages of one seed differ by their number.
    """
    random = generator(seed, page)
    # a page with margins, so wide that no word that begins within it goes beyond
    margin, word = _LETTER_HEIGHT, _WORD_LENGTHS[1] * (_LETTER_WIDTHS[1] + 1)
    height, width = shape[0] + margin, shape[1] + margin
    ink = np.zeros((height + margin, width + word), dtype=np.bool_)
    for top in range(margin + int(random.integers(-_LETTER_HEIGHT, 1)), height, _LEADING):
        left = margin + int(random.integers(-_LETTER_WIDTHS[1], 1))
        while left < width:
            for _ in range(random.integers(_WORD_LENGTHS[0], _WORD_LENGTHS[1] + 1)):
                letter = _letter(random)
                ink[top : top + _LETTER_HEIGHT, left : left + letter.shape[1]] |= letter
                left += letter.shape[1] + 1
            left += int(random.integers(1, 4))
    return ink[margin:height, margin:width]


def _letter(random: np.random.Generator) -> NDArray[np.bool_]:
    """A stem on the left and two or three more strokes, like a capital's."""
    width = int(random.integers(_LETTER_WIDTHS[0], _LETTER_WIDTHS[1] + 1))
    letter = np.zeros((_LETTER_HEIGHT, width), dtype=np.bool_)
    letter[:, : random.integers(1, 3)] = True
    rows = np.arange(_LETTER_HEIGHT)
    slant = 1 + rows * (width - 2) // (_LETTER_HEIGHT - 1)
    for stroke in random.choice(6, size=random.integers(2, 4), replace=False):
        if stroke < 3:  # a bar at the top, in the middle or at the foot
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
    """Albedo of one surface over an image or its own texels: float64 (H, W, C) in [0, 1].

    Parameters
    ----------
    kind
        ``"white"`` or ``"texture"``.
    channels
        1 (grey) or 3 (RGB, tinted).
    surface
        Number of the surface: its page and its tint.
    tint
        Factors of the albedo in red, green and blue, instead of those in `SURFACE_TINTS`; a grey
        surface takes the middle one.
    """
    grey = np.full(shape, {"white": WHITE, "texture": PAPER}[kind])
    if kind == "texture":
        grey[printed_page(shape, seed, surface)] = INK
    factors = np.array(tint or SURFACE_TINTS[surface % len(SURFACE_TINTS)])
    albedo: NDArray[np.float64] = grey[..., None] * (factors if channels > 1 else factors[1:2])
    return albedo
