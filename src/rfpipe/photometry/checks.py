"""Checks of a capture's first pictures, before anything is built on them."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError

__all__ = ["check_floodlit", "warn_if_dim"]

_log = logging.getLogger(__name__)


def check_floodlit(
    radiance: NDArray[Any], variance: NDArray[Any], significance: float = 5.0
) -> None:
    """Raise CaptureError unless the floodlit image holds light.

    Parameters
    ----------
    radiance, variance : ndarray of float, any one shape
        The merged floodlit image and its variance.
    significance : float
        Standard deviations of noise that light must exceed, in the sum over the image or, beyond
        what the largest of as many noisy samples reaches, in a sample.

    Raises
    ------
    CaptureError
        When the image is below the black level, or all black; when it is not finite.
    """
    image = np.asarray(radiance, np.float64)
    spread = np.asarray(variance, np.float64)
    if not (np.isfinite(image).all() and np.isfinite(spread).all()):
        raise CaptureError("the floodlit image or its variance holds NaN or infinity")
    total, error = float(image.sum()), float(np.sqrt(spread.sum()))
    if total < -significance * error:
        raise CaptureError(
            f"the floodlit image is darker than the all-off one: radiance {total:.3g} in all, "
            f"noise {error:.3g}. The black level is above the signal: check that the all-off "
            "frames were taken in the dark, with this camera and these exposures"
        )
    # the largest of n Gaussian samples is near sqrt(2 log n)
    threshold = significance + np.sqrt(2 * np.log(max(image.size, 2)))
    lit = image > threshold * np.sqrt(spread)
    if total <= significance * error and not lit.any():
        raise CaptureError(
            f"the floodlit image is all black: radiance {total:.3g} in all, noise {error:.3g}. "
            "Check that the projector is on, that the camera sees what it lights, and that the "
            "exposures are long enough"
        )


def warn_if_dim(radiance: NDArray[Any], variance: NDArray[Any], significance: float = 5.0) -> None:
    """Warn where a single picture of full light is hardly brighter than its noise.

    Patterns light a part of the projector, and indirect light is a part of theirs: what full light
    leaves near the noise, they leave below it.

    Parameters
    ----------
    radiance, variance : ndarray of float, any one shape
        The mean floodlit image, and the variance of one picture.
    significance : float
        Standard deviations of noise that a pixel's mean light should exceed.
    """
    light = float(np.mean(radiance, dtype=np.float64))
    noise = float(np.sqrt(np.mean(variance, dtype=np.float64)))
    if light < significance * noise:
        _log.warning(
            "the floodlit image is almost dark: its mean radiance, %.3g, is %.2g times a "
            "picture's noise. Indirect light will be lost in it: take longer exposures, a "
            "brighter projector, or a wider aperture",
            light,
            light / noise,
        )
