"""The smooth map from camera to projector behind a measured correspondence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.rigs.geometry import apply_homography

__all__ = ["LEAST_POINTS", "SmoothMap", "fit_map", "inner"]

Double = NDArray[np.float64]

LEAST_POINTS = 30
INLIER = 4.0
"""Robust deviations up to which a point belongs to the map."""

GAIN = 0.8
"""A polynomial is added to the homography where it leaves less than this share of the error at
points that it wasn't fitted to."""

DEGREE = 3

MARGIN = 6
LEAST_INNER = 0.25
"""Pixels at the edge of what is lit that don't tell of distortion, and the share that must remain:
there, blur moves the light's centre inwards, which looks like it."""


@dataclass(frozen=True, eq=False)
class SmoothMap:
    """A homography, and the lens distortion that it leaves.

    Both take points (x, y) in pixels from a picture's upper left corner.

    Attributes
    ----------
    homography : ndarray of float64, shape (3, 3)
        From the camera to the projector.
    distortion : ndarray of float64, shape (10, 2), or None
        Coefficients of a polynomial of degree 3 in normalised camera coordinates, added to it.
    centre, scale : ndarray of float64, shape (2,); float
        Of these coordinates.
    points, inliers : int
        Points fitted to, and those of them that belong to the map.
    rms : float
        Distance of a measured inlier from the map, in projector pixels: noise, texture and what
        the map can't describe.
    error : float
        Mean standard error of the map itself at its points, in projector pixels.
    """

    homography: Double
    distortion: Double | None
    centre: Double
    scale: float
    points: int
    inliers: int
    rms: float
    error: float

    def __call__(self, points: Double) -> Double:
        """Return the projector's points (..., 2) of camera points (..., 2)."""
        mapped = apply_homography(self.homography, points)
        if self.distortion is None:
            return mapped
        return mapped + _terms((points - self.centre) / self.scale) @ self.distortion

    def facts(self) -> dict[str, Any]:
        """Plain data for reports."""
        distortion = None if self.distortion is None else self.distortion.tolist()
        return {
            "homography": self.homography.tolist(),
            "distortion": distortion,
            "centre": self.centre.tolist(),
            "scale": self.scale,
            "points": self.points,
            "inliers": self.inliers,
            "rms_pixels": self.rms,
            "error_pixels": self.error,
        }


def inner(valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return valid pixels (H, W) that lie inside, away from the edge of what is valid.

    The margin is `MARGIN` pixels, or fewer where too few would remain. Holes are no edges.
    """
    from scipy.ndimage import binary_erosion, binary_fill_holes

    filled = binary_fill_holes(valid)
    for margin in range(MARGIN, 0, -1):
        inside = np.asarray(valid & binary_erosion(filled, iterations=margin))
        if inside.sum() >= max(4 * LEAST_POINTS, LEAST_INNER * valid.sum()):
            return inside
    return valid


def fit_map(
    camera: Double, projector: Double, trusted: NDArray[np.bool_] | None = None
) -> SmoothMap:
    """Fit a smooth map to points, robust against up to half of them being wrong.

    Parameters
    ----------
    camera, projector : ndarray of float64, shape (n, 2)
        Points that belong together, n at least `LEAST_POINTS`.
    trusted : ndarray of bool, shape (n,), optional
        Points that distortion is judged by; None for all. See `inner`.

    Raises
    ------
    CaptureError
        When there are too few points, or they span no plane.

    Notes
    -----
    Camera and projector of a coaxial rig share their centre: whatever the scene's depth, a
    homography joins their pictures, up to the lenses' distortion.
    """
    import cv2

    if len(camera) < LEAST_POINTS:
        raise CaptureError(
            f"{len(camera)} points of correspondence; a map needs {LEAST_POINTS} or more"
        )
    found, _ = cv2.findHomography(camera, projector, cv2.LMEDS)
    if found is None:
        raise CaptureError("the points of correspondence span no plane; check the structured light")
    homography = np.asarray(found, np.float64)
    inlier = _inliers(projector - apply_homography(homography, camera))
    refined, _ = cv2.findHomography(camera[inlier], projector[inlier], 0)
    homography = np.asarray(refined, np.float64)
    centre = camera.mean(axis=0)
    scale = float(np.abs(camera - centre).max())
    rest = projector - apply_homography(homography, camera)
    # lenses bend lines by far more than the noise of a pixel: look at all but gross errors
    near = _inliers(rest, 3 * INLIER)
    if trusted is not None:
        near &= trusted
    terms = _terms((camera - centre) / scale)
    even = np.flatnonzero(near)[::2], np.flatnonzero(near)[1::2]
    distortion = None
    if min(map(len, even)) > 5 * terms.shape[1]:
        left = [
            rest[test] - terms[test] @ np.linalg.lstsq(terms[train], rest[train])[0]
            for train, test in (even, even[::-1])
        ]
        if np.square(np.concatenate(left)).mean() < GAIN**2 * np.square(rest[near]).mean():
            distortion = np.asarray(np.linalg.lstsq(terms[near], rest[near])[0], np.float64)
            rest = rest - terms @ distortion
            inlier = _inliers(rest)
    rms = float(np.sqrt(np.square(rest[inlier]).sum(axis=1).mean()))
    parameters = 8 + (0 if distortion is None else distortion.size)
    count = int(inlier.sum())
    # the mean over the fitted points of the fit's own variance is rms^2 parameters / (2 n)
    error = rms * float(np.sqrt(parameters / (2 * count)))
    return SmoothMap(homography, distortion, centre, scale, len(camera), count, rms, error)


def _inliers(residual: Double, deviations: float = INLIER) -> NDArray[np.bool_]:
    distance = np.hypot(*residual.T)
    typical = MAD_TO_DEVIATION * float(np.median(distance))
    return np.asarray(distance <= max(deviations * typical, 1e-9))


def _terms(points: Double) -> Double:
    """Return the polynomial's terms at points (..., 2): (..., 10)."""
    x, y = points[..., 0], points[..., 1]
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=-1)
