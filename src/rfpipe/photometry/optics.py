"""What the lens does to an image before the sensor: blur, vignetting and flare."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["apply_optics"]

Float = NDArray[np.float32]


def apply_optics(radiance: Float, psf_sigma: float, vignetting: float, flare: float) -> Float:
    """Return the image on the sensor; linear in the radiance, each view and channel by itself.

    Parameters
    ----------
    radiance : ndarray of float32, shape (*camera_shape, C)
        Not negative.
    psf_sigma : float
        Standard deviation of the Gaussian point spread in pixels, 0 for none. The image is
        mirrored at its borders, so that no light is lost there.
    vignetting : float
        Fraction of the light lost in the corners by cos^4 falloff, in [0, 1).
    flare : float
        Fraction of a view's light that is spread evenly over the view, in [0, 1).

    Returns
    -------
    ndarray of float32, shape (*camera_shape, C)
    """
    image = radiance
    if psf_sigma > 0:
        from scipy.ndimage import gaussian_filter

        image = gaussian_filter(image, psf_sigma, axes=(-3, -2), mode="reflect")
    if vignetting > 0:
        image = image * _falloff(image.shape[-3], image.shape[-2], vignetting)
    if flare > 0:
        mean = image.mean(axis=(-3, -2), keepdims=True, dtype=np.float64)
        image = (1 - flare) * image + (flare * mean).astype(np.float32)
    return np.asarray(image, np.float32)


def _falloff(height: int, width: int, vignetting: float) -> Float:
    """Return cos^4 of the field angle, 1 at the centre and ``1 - vignetting`` in the corners."""
    y = np.arange(height) - (height - 1) / 2
    x = np.arange(width) - (width - 1) / 2
    radius_squared = y[:, None] ** 2 + x[None, :] ** 2
    corner = radius_squared[0, 0]
    if corner == 0:  # a single pixel is its own centre
        return np.ones((height, width, 1), np.float32)
    tangent_squared = (1 - vignetting) ** -0.5 - 1
    falloff = (1 + tangent_squared * radius_squared / corner) ** -2.0
    return np.asarray(falloff[..., None], np.float32)
