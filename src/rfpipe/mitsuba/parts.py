"""Materials, shapes and textures that scenes are put together of: dicts of Mitsuba's, plain data.

Lengths are in scene units: x to the right, y up, z towards the viewer. Colours are albedos, grey or
red, green and blue, linear, in [0, 1). Textures are float32 (H, W, 3), their first row on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.provenance import generator

Part = dict[str, Any]
Picture = NDArray[np.float32]
Vector = Sequence[float] | NDArray[np.float64]

# Five columns a letter, the lowest bit on top, seven rows.
_FONT = {
    "A": "7e1111117e", "D": "7f4141221c", "E": "7f49494941", "F": "7f09090901", "G": "3e4149497a",
    "H": "7f0808087f", "I": "00417f4100", "L": "7f40404040", "N": "7f0408107f", "O": "3e4141413e",
    "R": "7f09192946", "S": "4649494931", "T": "01017f0101", "U": "3f4040403f", " ": "0000000000",
}  # fmt: skip
_LINE = 9  # rows of a line, of which two part it from the next


def matt(*colour: float) -> Part:
    """Return a matt surface."""
    return {"type": "diffuse", "reflectance": _rgb(colour)}


def painted(picture: Picture) -> Part:
    """Return a matt surface of the albedos of a picture."""
    return {
        "type": "diffuse",
        "reflectance": {
            "type": "bitmap",
            "bitmap": np.ascontiguousarray(picture[::-1]),  # v goes upwards
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
        },
    }


def gloss(roughness: float, *colour: float) -> Part:
    """Return a coloured plastic under a rough coat."""
    return {"type": "roughplastic", "alpha": roughness, "diffuse_reflectance": _rgb(colour)}


def metal(roughness: float, *colour: float) -> Part:
    """Return a rough metal that reflects a share of the light."""
    rough = {"type": "roughconductor", "alpha": roughness, "specular_reflectance": _rgb(colour)}
    return mirror() | rough


def mirror(share: float = 0.9) -> Part:
    """Return a smooth mirror that reflects a share of the light."""
    return {"type": "conductor", "material": "none", "specular_reflectance": _rgb((share,))}


def glass(index: float = 1.5) -> Part:
    """Return the smooth boundary of a body of glass of a refractive index, in air."""
    return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}


def both_sides(material: Part) -> Part:
    """Return a surface seen from both sides."""
    return {"type": "twosided", "material": material}


def body(shape: Part, depth: float, forward: float, *colour: float) -> Part:
    """Return a closed shape filled with a translucent medium, its boundary not bending light.

    `depth` is the mean free path of light, `forward` the mean cosine of the angle of scattering,
    `colour` the share of light that is scattered rather than absorbed. Bodies mustn't meet.
    """
    medium = {
        "type": "homogeneous",
        "albedo": _rgb(colour),
        "sigma_t": 1 / depth,
        "phase": {"type": "hg", "g": forward},
    }
    return {**shape, "bsdf": {"type": "null"}, "interior": medium}


def sheet(centre: Vector, right: Vector, up: Vector, material: Part) -> Part:
    """Return a parallelogram, seen from both sides.

    `right` and `up` go from its centre to the middles of neighbouring edges: a texture's u and v.
    """
    ahead = np.cross(right, up)
    to_world = _rows(centre, right, up, ahead / np.linalg.norm(ahead))
    return {"type": "rectangle", "to_world": to_world, "bsdf": both_sides(material)}


def box(centre: Vector, size: Vector, degrees: float, material: Part) -> Part:
    """Return a box of a width, height and depth, turned about the vertical."""
    turn = np.radians(degrees)
    half = np.asarray(size) / 2
    right = np.array([np.cos(turn), 0, -np.sin(turn)]) * half[0]
    ahead = np.array([np.sin(turn), 0, np.cos(turn)]) * half[2]
    to_world = _rows(centre, right, [0, half[1], 0], ahead)
    return {"type": "cube", "to_world": to_world, "bsdf": material}


def ball(centre: Vector, radius: float, material: Part) -> Part:
    """Return a ball."""
    return {"type": "sphere", "center": _floats(centre), "radius": float(radius), "bsdf": material}


def pillar(foot: Vector, height: float, radius: float, material: Part) -> Part:
    """Return the upright wall of a pillar or a tumbler, seen from both sides, open at its ends."""
    top = _floats([foot[0], foot[1] + height, foot[2]])
    ends = {"p0": _floats(foot), "p1": top}
    return {"type": "cylinder", **ends, "radius": float(radius), "bsdf": material}


def turned(foot: Vector, profile: ArrayLike, material: Part) -> Part:
    """Return a body as turned on a lathe: a mesh, closed if its profile ends on the axis.

    The profile is radii and heights (K, 2), upwards from the foot of the upright axis; the outside
    of its material is away from the axis.
    """
    around = 96  # corners of each ring
    radii, heights = np.asarray(profile, dtype=np.float64).T
    angles = 2 * np.pi * np.arange(around) / around
    x, z = (np.outer(radii, wave(angles)) + foot[k] for wave, k in ((np.cos, 0), (np.sin, 2)))
    y = np.repeat(heights[:, None] + foot[1], around, axis=1)
    here = np.arange(len(radii) - 1)[:, None] * around + np.arange(around)
    beside = np.roll(here, -1, axis=1)
    corners = [here, here + around, beside, beside, here + around, beside + around]
    return {
        "type": "mesh",
        "vertices": np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32),
        "faces": np.stack(corners, axis=-1).reshape(-1, 3).astype(np.uint32),
        "bsdf": material,
    }


def lettering(
    lines: Sequence[str],
    ink: Sequence[float] = (0.06, 0.06, 0.08),
    paper: Sequence[float] = (0.8, 0.78, 0.7),
    *,
    fine: int = 4,
) -> Picture:
    """Return lines of capitals (KeyError for one that the font lacks), all as long as the first.

    A dot of the font is `fine` x `fine` pixels.
    """
    rows = []
    for line in lines:
        columns = [int(_FONT[letter][k : k + 2], 16) for letter in line for k in range(0, 10, 2)]
        dots = np.array(columns)[None] >> np.arange(_LINE)[:, None] & 1
        spaced = np.pad(dots.reshape(_LINE, len(line), 5), ((0, 0), (0, 0), (0, 1)))
        rows.append(np.pad(spaced.reshape(_LINE, -1), ((0, 0), (1, 0))))
    dotted = np.pad(np.concatenate(rows), ((2, 0), (1, 1)))
    return _mixed(np.kron(dotted, np.ones((fine, fine))), ink, paper)


def checks(
    rows: int,
    columns: int,
    dark: Sequence[float] = (0.1, 0.12, 0.3),
    light: Sequence[float] = (0.8, 0.75, 0.55),
) -> Picture:
    """Return a chessboard of `rows` by `columns` squares, each of 8 x 8 pixels."""
    share = np.add.outer(np.arange(rows), np.arange(columns)) % 2
    return _mixed(share.repeat(8, 0).repeat(8, 1), dark, light)


def blots(size: int, seed: int, colours: Sequence[Sequence[float]]) -> Picture:
    """Return round blots of random places and sizes, of the colours that follow the first's ground.

    The picture is `size` x `size` pixels.
    """
    random = generator(seed)
    picture = np.broadcast_to(np.asarray(colours[0], dtype=np.float32), (size, size, 3)).copy()
    y, x = np.mgrid[:size, :size] / size
    for _ in range(60):
        place, radius = random.random(2), random.uniform(0.02, 0.09)
        within = np.hypot(x - place[0], y - place[1]) < radius
        picture[within] = colours[1 + int(random.integers(len(colours) - 1))]
    return picture


def _mixed(share: NDArray[Any], one: Sequence[float], other: Sequence[float]) -> Picture:
    """Return a picture with a share (H, W) of one colour, the rest of another."""
    mixed = share[..., None] * np.array(one) + (1 - share[..., None]) * np.array(other)
    return np.asarray(mixed, dtype=np.float32)


def _rgb(colour: Sequence[float]) -> Part:
    """A grey, or red, green and blue, as Mitsuba's dict."""
    return {"type": "rgb", "value": _floats(np.broadcast_to(colour, 3))}


def _floats(values: Vector) -> list[float]:
    return [float(x) for x in values]


def _rows(centre: Vector, right: Vector, up: Vector, ahead: Vector) -> list[list[float]]:
    """Rows of the matrix that puts x, y and z of a shape along three vectors."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, up, ahead, centre], axis=1)
    return [_floats(row) for row in matrix]
