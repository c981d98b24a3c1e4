"""Whether the rays of a rig are seen and told apart, what keeps them from it, and what to do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Verdict
from rfpipe.calibration.mapping import SmoothMap
from rfpipe.calibration.rays import RayFit

__all__ = ["rays_verdict"]

MAP_WANTED = 0.1
"""Standard error of the smooth map in projector pixels that the rays bear."""

MOST_NOISE = 4.0
"""Noise of a ray over that of a camera pixel; one that few pixels see alone has up to about 2."""

MOST_UNSEEN = 0.02
"""Share of the rays that the camera may miss, as at a rim; more is a projector beside its view."""

BLURRED = 0.25
"""Blur, of a ray's side, that is undone with little noise."""

LEAST_PIXELS_A_RAY = 4.0
"""Camera pixels a ray below which few pixels look at one ray alone."""

_ASIDE = 0.1  # of the picture's extent, from its middle


def _whereabouts(rays: NDArray[np.bool_]) -> str:
    """Say on which side of the projector's picture most of some rays (*, H, W) are."""
    height, width = rays.shape[-2:]
    row, column = np.nonzero(rays.any(axis=tuple(range(rays.ndim - 2))))
    down, across = (row.mean() + 0.5) / height - 0.5, (column.mean() + 0.5) / width - 0.5
    words = [
        word
        for offset, less, more in ((down, "upper", "lower"), (across, "left", "right"))
        if (word := less if offset < -_ASIDE else more if offset > _ASIDE else "")
    ]
    return f"most of them on the {' '.join(words)} side" if words else "on no one side"


def rays_verdict(
    fit: RayFit,
    maps: list[SmoothMap],
    blur: float,
    tolerance: float,
    sharp: RayFit | None = None,
) -> Verdict:
    """Say whether rays are seen and told apart to the tolerance, and whether the map is known.

    Parameters
    ----------
    fit : RayFit
    maps : list of SmoothMap
        Of all views.
    blur : float
        Camera pixels.
    tolerance : float
        Of relit pictures; half of it is for light that leaks from ray to ray.
    sharp : RayFit, optional
        What it would be without the blur: tells blur from too few camera pixels.
    """
    seen = fit.resampling.seen
    unseen = int((~seen).sum())
    error = max(one.error for one in maps)
    leak = float(np.percentile(fit.leak, 99))
    pixels = float(np.median(fit.pixels[seen.ravel()]))
    faults = []
    if unseen > MOST_UNSEEN * seen.size:
        faults.append(
            f"{unseen:,} of {seen.size:,} rays are not seen ({unseen / seen.size:.0%}), "
            f"{_whereabouts(~seen)}; {MOST_UNSEEN:.0%} are allowed. Turn the camera or its "
            "zoom until all of the projector's picture is in its view, or light less of it."
        )
    if leak > tolerance / 2 or fit.noise.max() > MOST_NOISE:
        faults.append(_mixed(fit, leak, pixels, blur, tolerance, sharp or fit))
    if error > MAP_WANTED:
        # stripes that blur drowns make any map uncertain
        cause = (
            "as stripes are drowned by the blur: focus"
            if blur > BLURRED * np.sqrt(pixels)
            else "it is no smooth one. Is the rig coaxial?"
        )
        faults.append(
            f"The map from camera to projector is known to {error:.2f} projector pixels only, "
            f"above {MAP_WANTED}: {cause}"
        )
    text = (
        f"{pixels:.1f} camera pixels a ray, a leak of {leak:.2%}; the map fits within "
        f"{max(one.rms for one in maps):.2f} projector pixels a camera pixel, its own error is "
        f"{error:.3f}. The picture is blurred by {blur:.2f} camera pixels. {unseen} rays are not "
        "seen, and stay dark."
    )
    return Verdict.of(faults, text)


def _mixed(
    fit: RayFit, leak: float, pixels: float, blur: float, tolerance: float, sharp: RayFit
) -> str:
    """Say that rays are mixed in the camera's pixels, by what, the error that follows, the cure."""
    noise = float(fit.noise.max())
    leaks = (
        f"{leak:.1%} of other rays' light leaks into rays, more than {tolerance / 2:.1%}: pictures "
        "relit by direct light are off by about as much"
    )
    amplified = (
        f"the camera hardly tells some rays from their neighbours, and noise grows up to "
        f"{noise:.1f} times"
    )
    told = leaks if leak <= 1 and leak > tolerance / 2 else amplified
    by_blur = float(np.percentile(sharp.leak, 99)) <= max(tolerance / 2, leak / 2)
    if blur and by_blur and sharp.noise.max() <= max(MOST_NOISE, noise / 2):
        side = float(np.sqrt(pixels))
        return (
            f"Blur: the picture is blurred by {blur:.2f} camera pixels (standard deviation), "
            f"{blur / side:.0%} of a ray's side, so that {told}. Focus camera and projector, close "
            f"the aperture, or take rays {max(1.5, blur / side / BLURRED):.1f} times as large."
        )
    return (
        f"Rays share camera pixels: {told}. There are {pixels:.1f} camera pixels a ray; "
        f"{LEAST_PIXELS_A_RAY:.0f} or more are wanted: use larger rays, or a longer lens."
    )
