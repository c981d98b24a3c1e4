"""Materials and shapes that scenes are put together of, as dicts of Mitsuba's in plain data.

Lengths are in scene units: x to the right, y up, z towards the viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["box", "matt", "sheet"]

Vector = Sequence[float] | NDArray[np.float64]


def matt(*colour: float) -> dict[str, Any]:
    """Return a matt surface of an albedo: grey, or red, green and blue, linear, in [0, 1)."""
    rgb = list(colour) if len(colour) == 3 else list(colour) * 3
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": rgb}}


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


def _rows(centre: Vector, right: Vector, up: Vector, ahead: Vector) -> list[list[float]]:
    """Rows of the matrix that puts x, y and z of a shape along three vectors."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, up, ahead, centre], axis=1)
    return [[float(x) for x in row] for row in matrix]
