"""How far a relit image is from the truth: the figures of every error table."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

Image = NDArray[Any]


def relative_rms(image: Image, truth: Image, where: NDArray[np.bool_] | None = None) -> float:
    """Return ``||image - truth|| / ||truth||``, over all pixels and channels.

    Parameters
    ----------
    image, truth : ndarray of float, shape (*camera_shape, C)
        Radiance.
    where : ndarray of bool, shape (*camera_shape), optional
        The pixels to count; all by default.

    Returns
    -------
    float
        0 for equal images; NaN where there is no pixel, or no light in the truth.

    Raises
    ------
    InputError
        When the shapes differ.
    """
    image, truth = _checked(image, truth)
    if where is not None:
        image, truth = image[where], truth[where]
    light = float(np.linalg.norm(truth))
    return float(np.linalg.norm(image - truth)) / light if light > 0 else float("nan")


def unlit_rms(image: Image, truth: Image, pattern: Image) -> float:
    """Return `relative_rms` over the pixels where `pattern` (*camera_shape) is 0.

    With a coaxial rig these pixels show indirect light alone. NaN where there are none, or they
    get no light.
    """
    return relative_rms(image, truth, np.asarray(pattern) == 0)


def psnr(image: Image, truth: Image) -> float:
    """Return the peak signal-to-noise ratio in dB; the peak is the truth's maximum.

    Infinite for equal images, NaN when the truth is black.
    """
    image, truth = _checked(image, truth)
    peak = float(truth.max(initial=0.0))
    if peak <= 0:
        return float("nan")
    error = float(np.mean(np.square(image - truth)))
    return 10 * float(np.log10(peak * peak / error)) if error > 0 else float("inf")


def colour_difference(image: Image, truth: Image, white: float) -> float:
    """Return the mean CIEDE2000 difference over the pixels.

    Radiance is rendered as linear RGB with the sRGB primaries and D65 as white.

    Parameters
    ----------
    image, truth : ndarray of float, shape (*camera_shape, C)
        C is 3, or 1 for grey. Negative radiance counts as none.
    white : float
        Radiance shown as white: the maximum of the true floodlit image, above 0.

    Returns
    -------
    float
        About 1 is what an eye just notices; NaN when `white` isn't above 0.

    Raises
    ------
    InputError
        When the shapes differ or C is neither 1 nor 3.
    """
    image, truth = _checked(image, truth)
    if image.shape[-1] not in (1, 3):
        raise InputError(f"images of {image.shape[-1]} channels have no colour; expected 1 or 3")
    if not white > 0:
        return float("nan")
    import colour

    light = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]

    def lab(radiance: Image) -> Image:
        grey_or_rgb = np.maximum(radiance, 0) / white
        rgb = np.broadcast_to(grey_or_rgb, (*radiance.shape[:-1], 3))
        xyz = colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False)
        converted: Image = colour.XYZ_to_Lab(xyz, light)
        return converted

    return float(np.mean(colour.delta_E(lab(image), lab(truth), method="CIE 2000")))


def _checked(image: Image, truth: Image) -> tuple[Image, Image]:
    image, truth = np.asarray(image, np.float64), np.asarray(truth, np.float64)
    if image.shape != truth.shape:
        raise InputError(
            f"an image of shape {image.shape} can't be compared with a truth of {truth.shape}"
        )
    return image, truth
