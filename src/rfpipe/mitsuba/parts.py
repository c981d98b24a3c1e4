"""Materials, shapes and textures of scenes, as dicts for Mitsuba in plain data.

Lengths are in scene units: x to the right, y up, z towards the viewer. Colours are albedos, grey or
RGB, linear, in [0, 1). Textures are float32 (H, W, 3), with the top row first.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.provenance import generator

SceneDict = dict[str, Any]
Texture = NDArray[np.float32]
Vector = Sequence[float] | NDArray[np.float64]

# Letters of five columns (one byte per column, lowest bit on top) and seven rows.
_FONT = {
    "A": "7e1111117e", "D": "7f4141221c", "E": "7f49494941", "F": "7f09090901", "G": "3e4149497a",
    "H": "7f0808087f", "I": "00417f4100", "L": "7f40404040", "N": "7f0408107f", "O": "3e4141413e",
    "R": "7f09192946", "S": "4649494931", "T": "01017f0101", "U": "3f4040403f", " ": "0000000000",
}  # fmt: skip
_LINE = 9  # rows of a line, with two rows of spacing


def matt(*colour: float) -> SceneDict:
    """A diffuse surface."""
    return {"type": "diffuse", "reflectance": _rgb(colour)}


def textured(picture: Texture) -> SceneDict:
    """A diffuse surface with the albedos of a picture."""
    return {
        "type": "diffuse",
        "reflectance": {
            "type": "bitmap",
            "bitmap": np.ascontiguousarray(picture[::-1]),  # v points upwards
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
        },
    }


def gloss(roughness: float, *colour: float) -> SceneDict:
    """A coloured plastic with a rough coating."""
    return {"type": "roughplastic", "alpha": roughness, "diffuse_reflectance": _rgb(colour)}


def metal(roughness: float, *colour: float) -> SceneDict:
    """A rough metal with a specular reflectance."""
    rough = {"type": "roughconductor", "alpha": roughness, "specular_reflectance": _rgb(colour)}
    return mirror() | rough


def mirror(reflectance: float = 0.9) -> SceneDict:
    """A smooth mirror with a reflectance."""
    return {"type": "conductor", "material": "none", "specular_reflectance": _rgb((reflectance,))}


def glass(index: float = 1.5) -> SceneDict:
    """A smooth boundary of glass with a refractive index, in air."""
    return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}


def both_sides(material: SceneDict) -> SceneDict:
    """A material for both sides of a surface."""
    return {"type": "twosided", "material": material}


def body(shape: SceneDict, depth: float, forward: float, *colour: float) -> SceneDict:
    """A closed shape filled with a translucent medium, whose boundary doesn't refract.

    `depth` is the mean free path, `forward` the mean cosine of the scattering angle, `colour` the
    single-scattering albedo. Bodies must not touch.
    """
    medium = {
        "type": "homogeneous",
        "albedo": _rgb(colour),
        "sigma_t": 1 / depth,
        "phase": {"type": "hg", "g": forward},
    }
    return {**shape, "bsdf": {"type": "null"}, "interior": medium}


def sheet(centre: Vector, right: Vector, up: Vector, material: SceneDict) -> SceneDict:
    """A two-sided parallelogram.

    `right` and `up` point from its centre to the midpoints of adjacent edges, along a texture's u
    and v.
    """
    ahead = np.cross(right, up)
    to_world = _rows(centre, right, up, ahead / np.linalg.norm(ahead))
    return {"type": "rectangle", "to_world": to_world, "bsdf": both_sides(material)}


def box(centre: Vector, size: Vector, degrees: float, material: SceneDict) -> SceneDict:
    """A box of a width, height and depth, rotated about the vertical axis."""
    turn = np.radians(degrees)
    half = np.asarray(size) / 2
    right = np.array([np.cos(turn), 0, -np.sin(turn)]) * half[0]
    ahead = np.array([np.sin(turn), 0, np.cos(turn)]) * half[2]
    to_world = _rows(centre, right, [0, half[1], 0], ahead)
    return {"type": "cube", "to_world": to_world, "bsdf": material}


def ball(centre: Vector, radius: float, material: SceneDict) -> SceneDict:
    """A sphere."""
    return {"type": "sphere", "center": _floats(centre), "radius": float(radius), "bsdf": material}


def pillar(foot: Vector, height: float, radius: float, material: SceneDict) -> SceneDict:
    """An upright cylinder, open at both ends."""
    top = _floats([foot[0], foot[1] + height, foot[2]])
    ends = {"p0": _floats(foot), "p1": top}
    return {"type": "cylinder", **ends, "radius": float(radius), "bsdf": material}


def lathe(foot: Vector, profile: ArrayLike, material: SceneDict) -> SceneDict:
    """A surface of revolution about a vertical axis, as a mesh; closed if it ends on the axis.

    The profile has radii and heights (K, 2), upwards from the foot of the axis; normals point away
    from the axis.
    """
    around = 96  # vertices per ring
    radii, heights = np.asarray(profile, dtype=np.float64).T
    angles = 2 * np.pi * np.arange(around) / around
    x, z = (np.outer(radii, wave(angles)) + foot[k] for wave, k in ((np.cos, 0), (np.sin, 2)))
    y = np.repeat(heights[:, None] + foot[1], around, axis=1)
    index = np.arange(len(radii) - 1)[:, None] * around + np.arange(around)
    adjacent = np.roll(index, -1, axis=1)
    corners = [index, index + around, adjacent, adjacent, index + around, adjacent + around]
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
) -> Texture:
    """A texture of lines of capital letters; KeyError for letters that the font lacks.

    Lines must have the same length. A dot of the font is `fine` x `fine` pixels.
    """
    rows = []
    for line in lines:
        columns = [int(_FONT[letter][k : k + 2], 16) for letter in line for k in range(0, 10, 2)]
        dots = np.array(columns)[None] >> np.arange(_LINE)[:, None] & 1
        spaced = np.pad(dots.reshape(_LINE, len(line), 5), ((0, 0), (0, 0), (0, 1)))
        rows.append(np.pad(spaced.reshape(_LINE, -1), ((0, 0), (1, 0))))
    dotted = np.pad(np.concatenate(rows), ((2, 0), (1, 1)))
    return _blend(np.kron(dotted, np.ones((fine, fine))), ink, paper)


def checks(
    rows: int,
    columns: int,
    dark: Sequence[float] = (0.1, 0.12, 0.3),
    light: Sequence[float] = (0.8, 0.75, 0.55),
) -> Texture:
    """A chessboard texture of `rows` by `columns` squares of 8 x 8 pixels."""
    weight = np.add.outer(np.arange(rows), np.arange(columns)) % 2
    return _blend(weight.repeat(8, 0).repeat(8, 1), dark, light)


def discs(size: int, seed: int, colours: Sequence[Sequence[float]]) -> Texture:
    """A texture of 60 discs of random position, size and colour on the first colour.

    The texture has `size` x `size` pixels.
    """
    random = generator(seed)
    picture = np.broadcast_to(np.asarray(colours[0], dtype=np.float32), (size, size, 3)).copy()
    y, x = np.mgrid[:size, :size] / size
    for _ in range(60):
        centre, radius = random.random(2), random.uniform(0.02, 0.09)
        within = np.hypot(x - centre[0], y - centre[1]) < radius
        picture[within] = colours[1 + int(random.integers(len(colours) - 1))]
    return picture


def _blend(
    weight: NDArray[Any], foreground: Sequence[float], background: Sequence[float]
) -> Texture:
    """Blend two colours by the weight (H, W) of the foreground."""
    alpha = weight[..., None]
    blended = alpha * np.array(foreground) + (1 - alpha) * np.array(background)
    return np.asarray(blended, dtype=np.float32)


def _rgb(colour: Sequence[float]) -> SceneDict:
    """A grey or RGB colour as a dict for Mitsuba."""
    return {"type": "rgb", "value": _floats(np.broadcast_to(colour, 3))}


def _floats(values: Vector) -> list[float]:
    return [float(x) for x in values]


def _rows(centre: Vector, right: Vector, up: Vector, ahead: Vector) -> list[list[float]]:
    """Rows of the matrix that maps a shape's axes x, y and z to three vectors."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, up, ahead, centre], axis=1)
    return [_floats(row) for row in matrix]
