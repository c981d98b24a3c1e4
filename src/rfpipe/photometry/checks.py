"""Checks of a capture's first pictures, before anything is built on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError

__all__ = ["check_floodlit"]


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
