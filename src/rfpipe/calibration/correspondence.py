"""Which projector point each camera pixel looks at, the smooth maps behind it, views, and blur."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.gray_code import gray_bits, gray_code, gray_number
from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.rigs.layout import Quadrilateral, apply_homography, homography, pixel_middles

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_POINTS = 30
"""Points of correspondence that a map is fitted to, at least."""

_CELLS = 4
# Cells of the Gray code a period: half a cell and one misread neighbour are still less than the
# half period up to which the phase is unwrapped rightly.

_STEPS = 6  # sinusoids a period: harmonics up to the fourth don't bend the phase
_COARSER = 2  # period of the second sinusoids over that of the first; both tell the blur
_WEAK = 3.0  # standard deviations below which a bit is not told from its inverse
_INLIER = 4.0  # robust deviations up to which a point belongs to the map


@dataclass(frozen=True)
class AxisCode:
    """The pictures that tell one coordinate of the projector: Gray code, and sinusoids.

    A coordinate counts pixels from the picture's edge: a pixel's middle lies at a half.
    """

    extent: int
    period: int = 16

    @property
    def bits(self) -> int:
        """Bits of the Gray code, whose cells are a quarter of a period."""
        return max(1, gray_bits(-(-self.extent // (self.period // _CELLS))))

    def lines(self) -> list[Float]:
        """Return the weights along the axis of each picture: bits, each inverted; sinusoids."""
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
        """Return arrays (...) over the camera's pixels, for images (pictures, ...) under `lines`.

        Returns
        -------
        dict
            ``coordinate``; ``error``, its standard error by the noise; ``modulation``, amplitude
            of the sinusoids over its error; ``contrast``, amplitude over that of twice the period,
            1 where neither blur nor the pixel's extent takes any (indirect light is smooth, and has
            no share in either); ``valid``, where the sinusoids rise above the noise of as many
            pixels, at most one bit is weak and the coordinate lies on the projector.
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
        # an error of more than a period means nothing
        error = self.period / np.maximum(2 * np.pi * modulation, 1)
        # noise alone gives amplitudes up to about sqrt(2 log n)
        least = _WEAK + np.sqrt(2 * np.log(max(amplitude.size, 2)))
        valid = (modulation > least) & (amplitude > 0) & (weak <= 1)
        valid &= (coordinate >= 0) & (coordinate <= self.extent)
        return {
            "coordinate": coordinate, "error": error, "modulation": modulation,
            "contrast": contrast, "valid": valid,
        }  # fmt: skip

    def _wave(self, images: Double) -> tuple[Double, Double]:
        """Return amplitude and phase of sinusoids shifted step by step, (steps, ...)."""
        turn = np.exp(2j * np.pi * np.arange(_STEPS) / _STEPS)
        wave = np.tensordot(turn, images, 1) * 2 / _STEPS
        return np.abs(wave), np.angle(wave)


def measure_correspondence(bench: Bench) -> Findings:
    """Show structured light, that tells x and then y, and decode it.

    Most of where the projector's own light falls should be decoded.

    Returns
    -------
    Findings
        Arrays (Hc, Wc): ``x`` and ``y``, projector pixels from its upper left corner;
        ``error`` and ``modulation``, those of the worse axis; ``contrast`` (2, Hc, Wc); ``valid``.
    """
    shape, settings = bench.projector.shape, bench.settings
    codes = [AxisCode(extent, settings.period_pixels) for extent in shape[::-1]]
    lines = [code.lines() for code in codes]
    images = bench.radiance(
        [
            np.broadcast_to(np.expand_dims(line, axis), shape)
            for axis, along in enumerate(lines)
            for line in along
        ],
        linear=True,
    )
    decoded = []
    for code, along in zip(codes, lines, strict=True):
        taken = zip(*(next(images) for _ in along), strict=True)
        decoded.append(code.decode(*(np.stack(part) for part in taken)))
    x, y = decoded
    valid = x["valid"] & y["valid"]
    error = np.maximum(x["error"], y["error"]).astype(np.float32)
    lit = bench.found["scene"]["lit"] if "scene" in bench.found else valid
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
    """Return the projector points (Hc, Wc, 2), as (x, y), of a measured correspondence."""
    return np.stack([correspondence["x"], correspondence["y"]], axis=-1, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SmoothMap:
    """A homography from camera to projector, and the lens distortion that it leaves.

    Both take points (x, y) in pixels from a picture's upper left corner.

    Attributes
    ----------
    homography : ndarray of float64, shape (3, 3)
    distortion : ndarray of float64, shape (10, 2)
        Coefficients of a polynomial of degree 3 in normalised camera coordinates, added to it.
    centre, scale : ndarray of float64, shape (2,); float
        Of these coordinates.
    rms : float
        Distance of a measured inlier from the map, in projector pixels.
    error : float
        Mean standard error of the map itself at its points, in projector pixels.
    """

    homography: Double
    distortion: Double
    centre: Double
    scale: float
    rms: float
    error: float

    def __call__(self, points: Double) -> Double:
        """Return the projector's points (..., 2) of camera points (..., 2)."""
        bent = _terms((points - self.centre) / self.scale) @ self.distortion
        return apply_homography(self.homography, points) + bent


def map_of_pixels(correspondence: Findings, inside: Mask) -> SmoothMap:
    """Fit the map from camera to projector to some of the camera's pixels."""
    from scipy.ndimage import binary_erosion, binary_fill_holes

    # at the edge of what is lit blur moves the light's centre inwards, which looks like distortion;
    # holes are no edges
    filled = binary_fill_holes(inside)
    margins = (inside & binary_erosion(filled, iterations=margin) for margin in range(6, 0, -1))
    least = max(4 * LEAST_POINTS, 0.25 * inside.sum())
    inner = next((one for one in margins if one.sum() >= least), inside)
    here, there = pixel_middles(inside.shape), points_of(correspondence)
    return fit_map(here[inside], there[inside], inner[inside])


def fit_map(camera: Double, projector: Double, trusted: Mask | None = None) -> SmoothMap:
    """Fit a smooth map to points, robust against up to half of them being wrong.

    Parameters
    ----------
    camera, projector : ndarray of float64, shape (n, 2)
        Points that belong together, n at least `LEAST_POINTS`.
    trusted : ndarray of bool, shape (n,), optional
        Points that distortion is judged by; None for all.

    Raises
    ------
    CaptureError
        When there are too few points, or they span no plane.

    Notes
    -----
    Camera and projector of a coaxial rig share their centre: whatever the scene's depth, a
    homography joins their pictures, up to the lenses' distortion. A polynomial is added where it
    predicts points that it wasn't fitted to.
    """
    import cv2

    if len(camera) < LEAST_POINTS:
        raise CaptureError(
            f"{len(camera)} points of correspondence; a map needs {LEAST_POINTS} or more"
        )
    matrix, _ = cv2.findHomography(camera, projector, cv2.LMEDS)
    if matrix is None:
        raise CaptureError("the points of correspondence span no plane; check the structured light")
    inlier = _inliers(projector - apply_homography(np.asarray(matrix), camera))
    homography = np.asarray(cv2.findHomography(camera[inlier], projector[inlier], 0)[0], np.float64)
    centre = camera.mean(axis=0)
    scale = float(np.abs(camera - centre).max())
    rest = projector - apply_homography(homography, camera)
    # lenses bend lines by far more than the noise of a pixel: look at all but gross errors
    near = np.flatnonzero(_inliers(rest, 3 * _INLIER) & (True if trusted is None else trusted))
    terms = _terms((camera - centre) / scale)
    distortion, parameters = np.zeros((terms.shape[1], 2)), homography.size - 1
    halves = near[::2], near[1::2]
    if len(near) > 10 * terms.shape[1]:
        left = [
            rest[test] - terms[test] @ np.linalg.lstsq(terms[train], rest[train])[0]
            for train, test in (halves, halves[::-1])
        ]
        # a gain of a fifth is more than chance
        if np.square(np.concatenate(left)).mean() < 0.8**2 * np.square(rest[near]).mean():
            distortion = np.asarray(np.linalg.lstsq(terms[near], rest[near])[0], np.float64)
            rest, parameters = rest - terms @ distortion, parameters + distortion.size
            inlier = _inliers(rest)
    count = int(inlier.sum())
    rms = float(np.sqrt(np.square(rest[inlier]).sum(axis=1).mean()))
    # the mean over the fitted points of the fit's own variance is rms^2 parameters / (2 n)
    error = rms * float(np.sqrt(parameters / (2 * count)))
    return SmoothMap(homography, distortion, centre, scale, rms, error)


def fit_blur(correspondence: Findings, maps: Sequence[SmoothMap]) -> float:
    """Measure the blur of lens and projector as that of a Gaussian, the same all over the picture.

    Returns
    -------
    float
        Standard deviation in camera pixels, 0 where it isn't significant.

    Notes
    -----
    A Gaussian of deviation s takes ``exp(-2 pi^2 s^2 / P^2)`` of the amplitude of stripes of period
    P, a pixel's extent a ``sinc(a / P)``. The amplitude at P over that at 2 P needs neither the
    surface's albedo nor the indirect light, which stripes don't modulate.
    """
    measured, valid = points_of(correspondence), correspondence["valid"]
    period = float(correspondence["period_pixels"])
    points, squares = pixel_middles(valid.shape), []
    for to_projector in maps:
        right, down = np.array([0.5, 0]), np.array([0, 0.5])
        ahead = to_projector(points + right) - to_projector(points - right)
        below = to_projector(points + down) - to_projector(points - down)
        step = np.sqrt(np.square(ahead) + np.square(below))
        off = np.linalg.norm(measured - to_projector(points), axis=-1)
        own = valid & (off < step.max(axis=-1))
        for axis, contrast in enumerate(correspondence["contrast"]):
            chosen = own & (contrast > 0)
            extents = np.stack([ahead[chosen, axis], below[chosen, axis], np.ones(chosen.sum())])
            sharp, coarse = (np.sinc(extents / p).prod(axis=0) for p in (period, _COARSER * period))
            lost = np.log(sharp / coarse / contrast[chosen])
            factor = 2 * np.pi**2 * (1 - _COARSER**-2) / period**2
            squares.append(lost / factor / np.square(step[chosen, axis]))
    values = np.concatenate(squares)
    if not values.size:
        return 0.0
    square = float(np.median(values))
    spread = MAD_TO_DEVIATION * float(np.median(np.abs(values - square)))
    error = 1.2533 * spread / float(np.sqrt(values.size))
    return float(np.sqrt(square)) if square > 3 * error else 0.0


def find_views(correspondence: Findings, views: tuple[int, int]) -> list[Quadrilateral]:
    """Find the quadrilaterals that views light, as mirrors cut the camera's picture.

    Views are rows and columns of an array, as they lie on the projector.

    Returns
    -------
    list of Quadrilateral
        Row by row: (x, y) of the upper left, upper right, lower right and lower left corner, in
        projector pixels. Each is what the camera sees of a view, a little less.

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
    # coordinates jump from view to view
    jumps = steps > 6 * np.nanmedian(steps) if np.isfinite(steps).any() else False
    parts, found = label(valid & ~jumps)
    sizes = np.bincount(parts.ravel(), minlength=found + 1)[1:]
    large = np.count_nonzero(sizes >= LEAST_POINTS)
    if large < count:
        raise CaptureError(
            f"{large} views are told apart in the camera's picture; expected {views[0]} x "
            f"{views[1]}. Leave dark gaps between the mirrors' pictures, or give the views' "
            "corners in the settings"
        )
    quads = [_corners(points[parts == part]) for part in np.argsort(sizes)[::-1][:count] + 1]
    middle = np.mean(quads, axis=1)
    rows = np.argsort(middle[:, 1], kind="stable").reshape(views)
    ordered = np.concatenate([row[np.argsort(middle[row, 0], kind="stable")] for row in rows])
    return [[(float(x), float(y)) for x, y in quads[index]] for index in ordered]


def maps_of_views(correspondence: Findings, corners: Sequence[Quadrilateral]) -> list[SmoothMap]:
    """Fit the map from camera to projector of each view, to the pixels that look into it."""
    maps = []
    for quad in corners:
        to_unit = np.linalg.inv(homography((1, 1), quad))
        place = apply_homography(to_unit, points_of(correspondence))
        inside = correspondence["valid"] & ((place >= 0) & (place <= 1)).all(axis=-1)
        maps.append(map_of_pixels(correspondence, inside))
    return maps


def _corners(points: Double) -> Double:
    """Return the corners (4, 2) of the quadrilateral that points (n, 2) fill, moved inwards.

    The corners are the points farthest out along the diagonals of the bounding box, stray ones
    left out.
    """
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    margin = 0.02 * (high - low)
    points = points[((points >= low - margin) & (points <= high + margin)).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    towards = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = points[np.argmax((points - low) / (high - low) @ towards.T, axis=0)]
    return np.asarray(corners + 0.02 * (corners.mean(axis=0) - corners))  # off the mirror's edge


def _inliers(residual: Double, deviations: float = _INLIER) -> Mask:
    distance = np.hypot(*residual.T)
    typical = MAD_TO_DEVIATION * float(np.median(distance))
    return np.asarray(distance <= max(deviations * typical, 1e-9))


def _terms(points: Double) -> Double:
    """Return the polynomial's terms at points (..., 2): (..., 10)."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=-1)
