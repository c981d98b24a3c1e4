"""Correspondence of camera pixels and projector points: decoding, smooth maps, views, and blur."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double, Float
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.gray_code import gray_bits, gray_code, gray_number
from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.rigs.layout import Quadrilateral, apply_homography, homography, pixel_middles

LEAST_POINTS = 30
"""Smallest number of points to which a map is fitted."""

_CELLS = 4
# Cells of the Gray code per period. Half a cell and one misread neighbour are less than half a
# period, within which the phase is unwrapped correctly.

_STEPS = 6  # sinusoids per period: harmonics up to the fourth don't change the phase
_COARSER = 2  # ratio of the periods of the second and the first sinusoids, to measure the blur
_WEAK = 3.0  # standard deviations below which a bit and its inverse are indistinguishable
_INLIER = 4.0  # robust deviations up to which a point is an inlier of the map


@dataclass(frozen=True)
class AxisCode:
    """Structured light that encodes one projector coordinate: Gray code, and sinusoids.

    A coordinate counts pixels from the picture's edge: the centre of the first pixel is at 0.5.
    """

    extent: int
    period: int = 16

    @property
    def bits(self) -> int:
        """Number of bits of the Gray code, whose cells are a quarter of a period."""
        return max(1, gray_bits(-(-self.extent // (self.period // _CELLS))))

    def lines(self) -> list[Float]:
        """Weights of each picture along the axis: bits, each with its inverse; sinusoids."""
        pixel = np.arange(self.extent)
        cell = pixel // (self.period // _CELLS)
        lines = []
        for code in gray_code(cell, self.bits).astype(np.float32):
            lines += [code, 1 - code]
        for period in (self.period, _COARSER * self.period):
            for step in range(_STEPS):
                phase = 2 * np.pi * ((pixel + 0.5) / period - step / _STEPS)
                lines.append((0.5 + 0.5 * np.cos(phase)).astype(np.float32))
        return lines

    def decode(self, images: Double, variance: Double) -> dict[str, NDArray[Any]]:
        """Decode the coordinate of each camera pixel from images under `lines`.

        Parameters
        ----------
        images, variance : ndarray of float64, shape (pictures, ...)

        Returns
        -------
        dict of ndarray, shape (...)
            ``coordinate``; ``error``, its standard error; ``modulation``, amplitude of the
            sinusoids over their noise; ``contrast``, amplitude relative to the amplitude at twice
            the period, 1 without blur (indirect light is smooth and modulates neither); ``valid``,
            where the modulation is significant, at most one bit is weak and the coordinate lies on
            the projector.
        """
        split = 2 * self.bits
        bright, inverse = images[:split:2], images[1:split:2]
        spread = np.sqrt(variance[:split:2] + variance[1:split:2])
        weak = (np.abs(bright - inverse) <= _WEAK * spread).sum(axis=0)
        coarse = (gray_number(bright > inverse) + 0.5) * (self.period // _CELLS)
        amplitude, phase = self._wave(images[split : split + _STEPS])
        smooth, _ = self._wave(images[split + _STEPS :])
        noise = np.sqrt(variance[split:].mean(axis=0) * 2 / _STEPS)
        fine = self.period * phase / (2 * np.pi)
        coordinate = fine + self.period * np.round((coarse - fine) / self.period)
        with np.errstate(divide="ignore", invalid="ignore"):
            modulation = np.where(noise > 0, amplitude / noise, np.inf)
            contrast = np.where(smooth > _WEAK * noise, amplitude / smooth, 0)
        # limited to one period, beyond which an error has no meaning
        error = self.period / np.maximum(2 * np.pi * modulation, 1)
        # the largest of n amplitudes of pure noise is about sqrt(2 log n)
        least = _WEAK + np.sqrt(2 * np.log(max(amplitude.size, 2)))
        valid = (modulation > least) & (amplitude > 0) & (weak <= 1)
        valid &= (coordinate >= 0) & (coordinate <= self.extent)
        return {
            "coordinate": coordinate, "error": error, "modulation": modulation,
            "contrast": contrast, "valid": valid,
        }  # fmt: skip

    def _wave(self, images: Double) -> tuple[Double, Double]:
        """Amplitude and phase of a phase-shifted sinusoid, from images (steps, ...)."""
        turn = np.exp(2j * np.pi * np.arange(_STEPS) / _STEPS)
        wave = np.tensordot(turn, images, 1) * 2 / _STEPS
        return np.abs(wave), np.angle(wave)


def measure_correspondence(context: StepContext) -> Findings:
    """Show structured light for x and y, and decode it.

    Returns
    -------
    Findings
        Arrays (Hc, Wc): ``x`` and ``y`` in projector pixels from its upper left corner; ``error``
        and ``modulation`` of the worse axis; ``contrast`` (2, Hc, Wc); ``valid``.
    """
    shape, settings = context.projector.shape, context.settings
    codes = [AxisCode(extent, settings.period_pixels) for extent in shape[::-1]]
    lines = [code.lines() for code in codes]
    images = context.radiance(
        [
            np.broadcast_to(np.expand_dims(line, axis), shape)
            for axis, along in enumerate(lines)
            for line in along
        ],
        linear=True,
    )
    decoded = []
    for code, along in zip(codes, lines, strict=True):
        radiance, variance = zip(*(next(images) for _ in along), strict=True)
        decoded.append(code.decode(np.stack(radiance), np.stack(variance)))
    x, y = decoded
    valid = x["valid"] & y["valid"]
    error = np.maximum(x["error"], y["error"]).astype(np.float32)
    lit = context.findings["scene"]["lit"] if "scene" in context.findings else valid
    is_few, of_lit = valid.sum() < 100, float(valid[lit].mean()) if lit.any() else 1.0
    facts = {
        "projector_shape": list(shape),
        "period_pixels": settings.period_pixels,
        "valid_pixels": int(valid.sum()),
        "valid_share": float(valid.mean()),
        "decoded_of_lit": None if is_few else of_lit,
        "median_error_pixels": None if is_few or of_lit < 0.7 else float(np.median(error[valid])),
    }
    arrays = {
        "x": x["coordinate"].astype(np.float32),
        "y": y["coordinate"].astype(np.float32),
        "error": error,
        "modulation": np.minimum(x["modulation"], y["modulation"]).astype(np.float32),
        "contrast": np.stack([x["contrast"], y["contrast"]]).astype(np.float32),
        "valid": valid,
    }
    return Findings.of("correspondence", facts, arrays)


def points_of(correspondence: Findings) -> Double:
    """Projector points (x, y) of a measured correspondence, float64 (Hc, Wc, 2)."""
    return np.stack([correspondence["x"], correspondence["y"]], axis=-1, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SmoothMap:
    """A homography from camera to projector with a polynomial for lens distortion.

    Points are (x, y) in pixels from a picture's upper left corner.

    Attributes
    ----------
    homography : ndarray of float64, shape (3, 3)
    distortion : ndarray of float64, shape (10, 2)
        Coefficients of a polynomial of degree 3 in normalised camera coordinates, which is added to
        the homography.
    centre, scale : ndarray of float64, shape (2,); float
        Origin and unit of the normalised coordinates.
    rms : float
        RMS distance of the inliers from the map, in projector pixels.
    error : float
        Mean standard error of the map at its points, in projector pixels.
    """

    homography: Double
    distortion: Double
    centre: Double
    scale: float
    rms: float
    error: float

    def __call__(self, points: Double) -> Double:
        """Map camera points (..., 2) to projector points (..., 2)."""
        bent = _terms((points - self.centre) / self.scale) @ self.distortion
        return apply_homography(self.homography, points) + bent


def map_of_pixels(correspondence: Findings, inside: Bools) -> SmoothMap:
    """Fit the map from camera to projector to the camera pixels in the mask `inside`."""
    from scipy.ndimage import binary_erosion, binary_fill_holes

    # at the outer edge of the lit area, blur shifts the light's centroid inwards, which resembles
    # lens distortion
    filled = binary_fill_holes(inside)
    masks = (inside & binary_erosion(filled, iterations=margin) for margin in range(6, 0, -1))
    least = max(4 * LEAST_POINTS, 0.25 * inside.sum())
    inner = next((mask for mask in masks if mask.sum() >= least), inside)
    camera, projector = pixel_middles(inside.shape), points_of(correspondence)
    return fit_map(camera[inside], projector[inside], inner[inside])


def fit_map(camera: Double, projector: Double, trusted: Bools | None = None) -> SmoothMap:
    """Fit a smooth map to points; up to half of the points may be outliers.

    Parameters
    ----------
    camera, projector : ndarray of float64, shape (n, 2)
        Corresponding points, n at least `LEAST_POINTS`.
    trusted : ndarray of bool, shape (n,), optional
        Points to which the distortion is fitted; None for all.

    Raises
    ------
    CaptureError
        When there are too few points, or they span no plane.

    Notes
    -----
    Camera and projector of a coaxial rig have a common centre of projection, so that a homography
    relates their pictures for any depth of the scene, apart from the lenses' distortion. A
    polynomial for the distortion is added where it predicts held-out points better.
    """
    import cv2

    if len(camera) < LEAST_POINTS:
        raise CaptureError(
            f"only {len(camera)} camera pixels have a projector point; a map needs {LEAST_POINTS} "
            "or more",
            remedy="Check focus and exposures of the step correspondence",
        )
    matrix, _ = cv2.findHomography(camera, projector, cv2.LMEDS)
    if matrix is None:
        raise CaptureError(
            "the decoded projector points don't span a plane",
            remedy="check the projector's picture and the step correspondence",
        )
    inlier = _inliers(projector - apply_homography(np.asarray(matrix), camera))
    homography = np.asarray(cv2.findHomography(camera[inlier], projector[inlier], 0)[0], np.float64)
    centre = camera.mean(axis=0)
    scale = float(np.abs(camera - centre).max())
    residual = projector - apply_homography(homography, camera)
    # distortion exceeds the noise of a pixel by far: exclude gross errors only
    near = np.flatnonzero(_inliers(residual, 3 * _INLIER) & (True if trusted is None else trusted))
    terms = _terms((camera - centre) / scale)
    distortion, parameters = np.zeros((terms.shape[1], 2)), homography.size - 1
    halves = near[::2], near[1::2]
    if len(near) > 10 * terms.shape[1]:
        held_out = [
            residual[test] - terms[test] @ np.linalg.lstsq(terms[train], residual[train])[0]
            for train, test in (halves, halves[::-1])
        ]
        # the residual has to decrease by 20 %, more than by chance
        if np.square(np.concatenate(held_out)).mean() < 0.8**2 * np.square(residual[near]).mean():
            distortion = np.asarray(np.linalg.lstsq(terms[near], residual[near])[0], np.float64)
            residual, parameters = residual - terms @ distortion, parameters + distortion.size
            inlier = _inliers(residual)
    count = int(inlier.sum())
    rms = float(np.sqrt(np.square(residual[inlier]).sum(axis=1).mean()))
    # the variance of the fit, averaged over the fitted points, is rms^2 parameters / (2 n)
    error = rms * float(np.sqrt(parameters / (2 * count)))
    return SmoothMap(homography, distortion, centre, scale, rms, error)


def fit_blur(correspondence: Findings, maps: Sequence[SmoothMap]) -> float:
    """Fit the blur of camera and projector by a Gaussian, uniform over the picture.

    Returns
    -------
    float
        Standard deviation in camera pixels, 0 where it isn't significant.

    Notes
    -----
    A Gaussian of deviation s multiplies the amplitude of stripes of period P by
    ``exp(-2 pi^2 s^2 / P^2)``, a pixel of extent a by ``sinc(a / P)``. The ratio of the amplitudes
    at P and 2 P depends neither on the surface's albedo nor on indirect light, which stripes don't
    modulate.
    """
    measured, valid = points_of(correspondence), correspondence["valid"]
    period = float(correspondence["period_pixels"])
    points, squares = pixel_middles(valid.shape), []
    for to_projector in maps:
        right, down = np.array([0.5, 0]), np.array([0, 0.5])
        ahead = to_projector(points + right) - to_projector(points - right)
        below = to_projector(points + down) - to_projector(points - down)
        step = np.sqrt(np.square(ahead) + np.square(below))
        distance = np.linalg.norm(measured - to_projector(points), axis=-1)
        near = valid & (distance < step.max(axis=-1))
        for axis, contrast in enumerate(correspondence["contrast"]):
            chosen = near & (contrast > 0)
            extents = np.stack([ahead[chosen, axis], below[chosen, axis], np.ones(chosen.sum())])
            sharp, coarse = (np.sinc(extents / p).prod(axis=0) for p in (period, _COARSER * period))
            loss = np.log(sharp / coarse / contrast[chosen])
            factor = 2 * np.pi**2 * (1 - _COARSER**-2) / period**2
            squares.append(loss / factor / np.square(step[chosen, axis]))
    values = np.concatenate(squares)
    if not values.size:
        return 0.0
    square = float(np.median(values))
    spread = MAD_TO_DEVIATION * float(np.median(np.abs(values - square)))
    error = 1.2533 * spread / float(np.sqrt(values.size))
    return float(np.sqrt(square)) if square > 3 * error else 0.0


def find_views(correspondence: Findings, views: tuple[int, int]) -> list[Quadrilateral]:
    """Find the projector's quadrilaterals of several views, as seen by mirrors.

    Parameters
    ----------
    correspondence : Findings
    views : (int, int)
        Rows and columns of the array of views on the projector.

    Returns
    -------
    list of Quadrilateral
        Row by row: (x, y) of the upper left, upper right, lower right and lower left corner, in
        projector pixels. Each covers the part of the view that the camera sees, less a margin.

    Raises
    ------
    CaptureError
        When fewer views are found.
    """
    from scipy.ndimage import label

    points, count = points_of(correspondence), views[0] * views[1]
    valid = correspondence["valid"]
    known = np.where(valid[..., None], points, np.nan)
    steps = np.max([np.abs(slope) for slope in np.gradient(known, axis=(0, 1))], axis=(0, -1))
    # coordinates are discontinuous between views
    jumps = steps > 6 * np.nanmedian(steps) if np.isfinite(steps).any() else False
    parts, part_count = label(valid & ~jumps)
    sizes = np.bincount(parts.ravel(), minlength=part_count + 1)[1:]
    large = np.count_nonzero(sizes >= LEAST_POINTS)
    if large < count:
        raise CaptureError(
            f"the camera's picture has {large} separate views; expected {views[0]} x {views[1]}",
            remedy="Leave dark gaps between the mirrors' pictures, or set the views' corners "
            "(calibrate.corners)",
        )
    quads = [_corners(points[parts == part]) for part in np.argsort(sizes)[::-1][:count] + 1]
    middle = np.mean(quads, axis=1)
    rows = np.argsort(middle[:, 1], kind="stable").reshape(views)
    ordered = np.concatenate([row[np.argsort(middle[row, 0], kind="stable")] for row in rows])
    return [[(float(x), float(y)) for x, y in quads[index]] for index in ordered]


def maps_of_views(correspondence: Findings, corners: Sequence[Quadrilateral]) -> list[SmoothMap]:
    """Fit the map from camera to projector of each view, to the pixels inside its corners."""
    maps = []
    for quad in corners:
        to_unit = np.linalg.inv(homography((1, 1), quad))
        place = apply_homography(to_unit, points_of(correspondence))
        inside = correspondence["valid"] & ((place >= 0) & (place <= 1)).all(axis=-1)
        maps.append(map_of_pixels(correspondence, inside))
    return maps


def _corners(points: Double) -> Double:
    """Corners (4, 2) of the quadrilateral that points (n, 2) fill, moved inwards by 2 %.

    The corners are the extreme points along the diagonals of the bounding box, without outliers.
    """
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    margin = 0.02 * (high - low)
    points = points[((points >= low - margin) & (points <= high + margin)).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    towards = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = points[np.argmax((points - low) / (high - low) @ towards.T, axis=0)]
    return np.asarray(corners + 0.02 * (corners.mean(axis=0) - corners))  # off the mirror's edge


def _inliers(residual: Double, deviations: float = _INLIER) -> Bools:
    distance = np.hypot(*residual.T)
    typical = MAD_TO_DEVIATION * float(np.median(distance))
    return np.asarray(distance <= max(deviations * typical, 1e-9))


def _terms(points: Double) -> Double:
    """Terms of a polynomial of degree 3 at points (..., 2), shape (..., 10)."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=-1)
