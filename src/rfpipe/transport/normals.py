"""Surface normals and albedo from pictures of one light at a time, by photometric stereo.

See `rfpipe.lights.shading` for the equation and its robust solution. Lights may differ in power by
a few percent; larger differences tilt the normals.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.lights.interpolation import unit
from rfpipe.lights.shading import fit_shading, shaded
from rfpipe.transport.algebra import MatrixAlgebra

_FEWEST = 3
"""Lights that a normal needs: it has three unknowns with its albedo."""

_CUTOFF = 1.0
"""Median absolute residuals at which a light has half its weight: normals on a matt sphere with
lights placed to a few degrees were 3.6 degrees off, 3.8 at twice that."""

_DARK = 1e-3
"""Albedo, over that of the brightest pixels, below which a pixel is left out of the mask."""


@dataclass(frozen=True)
class Normals:
    """Normals and albedo of what the camera sees.

    Attributes
    ----------
    normals : ndarray of float32, shape (*camera_shape, 3)
        Unit vectors in the frame of the lights' directions: for most domes x points right, y up
        and z to the camera. 0 outside the mask.
    albedo : ndarray of float32, shape (*camera_shape, channels)
        Radiance of a surface that faces a light, in the unit of the pictures.
    uncertainty : ndarray of float32, shape (*camera_shape)
        Standard deviation of the normal's direction, degrees, at most 90, from the residuals of
        the pixel's fit. Errors that all pixels share, such as those of the lights' directions, are
        not in it.
    mask : ndarray of bool, shape (*camera_shape)
        Pixels that at least three lights light, without those rejected as shadow or highlight.
    """

    normals: Float
    albedo: Float
    uncertainty: Float
    mask: NDArray[np.bool_]


def normals_of(transport: MatrixAlgebra, lights: Float | None) -> Normals:
    """Estimate normals and albedo from the pictures of a transport of single lights.

    `lights` are their directions, float32 (rays, 3), or None where unknown.

    Normals are fitted to the mean of the channels, the albedo of each channel to its pictures.

    Raises
    ------
    InputError
        If the lights' directions are unknown, there are fewer than three, or they lie in one plane
        with the scene; if the pictures take more than the memory budget.
    """
    if lights is None:
        raise InputError(
            "the transport has no directions of its lights: fit it from a folder with a file of "
            "their directions, or set transport.lights, one direction for each ray"
        )
    directions = unit(lights)
    if np.linalg.svd(directions, compute_uv=False)[_FEWEST - 1 :].sum() < 0.05:
        raise InputError(
            f"{len(directions)} lights: normals need at least three lights whose directions do not "
            "lie in one plane"
        )
    pictures = transport.toarray()
    grey = pictures.mean(axis=0, dtype=np.float32).T
    vectors, uncertainty, lit = fit_shading(grey, directions, _CUTOFF)
    length = np.linalg.norm(vectors, axis=1)
    normals = vectors / np.maximum(length, 1e-30)[:, None]
    shading = shaded(normals, directions)
    trusted = np.where(np.abs(grey - length * shading) <= 0.1 * length + 1e-30, shading, 0)
    power = np.maximum((trusted * shading).sum(axis=0), 1e-30)
    albedo = np.einsum("cpl,lp->pc", pictures, trusted) / power[:, None]
    bright = np.quantile(length, 0.99) if prod(length.shape) else 0
    mask = (lit >= _FEWEST) & (length > _DARK * bright)
    shape = transport.camera_shape
    return Normals(
        (normals * mask[:, None]).astype(np.float32).reshape(*shape, 3),
        (np.maximum(albedo, 0) * mask[:, None]).astype(np.float32).reshape(*shape, -1),
        np.where(mask, np.degrees(uncertainty), 90).astype(np.float32).reshape(shape),
        mask.reshape(shape),
    )
