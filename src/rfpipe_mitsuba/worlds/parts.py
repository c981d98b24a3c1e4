"""Materials and shapes that scenes are put together of, as dicts of Mitsuba's in plain data.

Lengths are in scene units: x to the right, y up, z towards the viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ball",
    "body",
    "box",
    "glass",
    "gloss",
    "matt",
    "metal",
    "mirror",
    "painted",
    "pillar",
    "sheet",
    "turned",
]

Vector = Sequence[float] | NDArray[np.float64]


def matt(*colour: float) -> dict[str, Any]:
    """Return a matt surface of an albedo: grey, or red, green and blue, linear, in [0, 1)."""
    return {"type": "diffuse", "reflectance": _rgb(colour)}


def painted(picture: NDArray[np.float32]) -> dict[str, Any]:
    """Return a matt surface of the albedos of a picture float32 (H, W, 3), its first row on top."""
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


def gloss(roughness: float, *colour: float) -> dict[str, Any]:
    """Return a coloured plastic under a rough coat."""
    return {"type": "roughplastic", "alpha": roughness, "diffuse_reflectance": _rgb(colour)}


def metal(roughness: float, *colour: float) -> dict[str, Any]:
    """Return a rough metal that reflects a share of the light."""
    return {
        "type": "roughconductor",
        "material": "none",
        "alpha": roughness,
        "specular_reflectance": _rgb(colour),
    }


def mirror(share: float = 0.9) -> dict[str, Any]:
    """Return a smooth mirror that reflects a share of the light."""
    return {"type": "conductor", "material": "none", "specular_reflectance": _rgb((share,))}


def glass(index: float = 1.5) -> dict[str, Any]:
    """Return the smooth boundary of a body of glass of a refractive index, in air."""
    return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}


def body(shape: dict[str, Any], depth: float, forward: float, *colour: float) -> dict[str, Any]:
    """Return a shape filled with a translucent medium, its boundary not bending light.

    Parameters
    ----------
    shape
        A closed one. Two of them mustn't meet.
    depth
        Mean free path of light in it, in scene units.
    forward
        Mean cosine of the angle of scattering, -1 to 1.
    colour
        Share of the light that is scattered rather than absorbed, in all or of each channel.
    """
    medium = {
        "type": "homogeneous",
        "albedo": _rgb(colour),
        "sigma_t": 1 / depth,
        "phase": {"type": "hg", "g": forward},
    }
    return {**shape, "bsdf": {"type": "null"}, "interior": medium}


def sheet(centre: Vector, right: Vector, up: Vector, material: dict[str, Any]) -> dict[str, Any]:
    """Return a parallelogram, seen from both sides.

    Parameters
    ----------
    centre
        Its centre.
    right, up
        From the centre to the middles of two neighbouring edges; a texture's u and v.
    material
        Its surface.
    """
    ahead = np.cross(right, up)
    return {
        "type": "rectangle",
        "to_world": _rows(centre, right, up, ahead / np.linalg.norm(ahead)),
        "bsdf": {"type": "twosided", "material": material},
    }


def box(centre: Vector, size: Vector, degrees: float, material: dict[str, Any]) -> dict[str, Any]:
    """Return a box of a width, height and depth, turned about the vertical."""
    turn = np.radians(degrees)
    half = np.asarray(size) / 2
    right = np.array([np.cos(turn), 0, -np.sin(turn)]) * half[0]
    ahead = np.array([np.sin(turn), 0, np.cos(turn)]) * half[2]
    to_world = _rows(centre, right, [0, half[1], 0], ahead)
    return {"type": "cube", "to_world": to_world, "bsdf": material}


def ball(centre: Vector, radius: float, material: dict[str, Any]) -> dict[str, Any]:
    """Return a ball."""
    return {
        "type": "sphere",
        "center": [float(x) for x in centre],
        "radius": float(radius),
        "bsdf": material,
    }


def pillar(foot: Vector, height: float, radius: float, material: dict[str, Any]) -> dict[str, Any]:
    """Return the upright wall of a pillar or a tumbler, seen from both sides, open at its ends."""
    return {
        "type": "cylinder",
        "p0": [float(x) for x in foot],
        "p1": [float(foot[0]), float(foot[1] + height), float(foot[2])],
        "radius": float(radius),
        "bsdf": material,
    }


def turned(
    foot: Vector, profile: ArrayLike, material: dict[str, Any], *, around: int = 96
) -> dict[str, Any]:
    """Return a body as turned on a lathe: a mesh, closed if its profile ends on the axis.

    Parameters
    ----------
    foot
        Where its axis, which is upright, starts.
    profile
        Radii and heights (K, 2), upwards.
    material
        Its surface, whose outside is away from the axis.
    around
        Corners of each ring.
    """
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


def _rgb(colour: Sequence[float]) -> dict[str, Any]:
    """A grey, or red, green and blue, as Mitsuba's dict."""
    return {"type": "rgb", "value": [float(x) for x in np.broadcast_to(colour, 3)]}


def _rows(centre: Vector, right: Vector, up: Vector, ahead: Vector) -> list[list[float]]:
    """Rows of the matrix that puts x, y and z of a shape along three vectors."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, up, ahead, centre], axis=1)
    return [[float(x) for x in row] for row in matrix]
