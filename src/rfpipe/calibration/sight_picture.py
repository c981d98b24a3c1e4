"""The picture of what the camera sees, for people: too bright in red, too dark in blue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.pictures.images import srgb

__all__ = ["sight_picture"]

RED, BLUE, YELLOW = (0.9, 0.1, 0.1), (0.15, 0.3, 0.95), (1.0, 0.82, 0.12)


def sight_picture(
    white: NDArray[np.floating],
    saturated: NDArray[np.bool_],
    dark: NDArray[np.bool_],
    outline_of: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Return the scene as RGB in [0, 1] for a screen.

    Parameters
    ----------
    white : ndarray, shape (H, W)
        Light, in any unit; its brightest half per cent are white.
    saturated, dark : ndarray of bool, shape (H, W)
        What is shown in red, and what in blue.
    outline_of : ndarray of bool, shape (H, W), optional
        An area whose outline is drawn in yellow.
    """
    light = np.maximum(white, 0)
    picture = np.array(srgb(light[..., None], float(np.percentile(light, 99.5)) or 1.0))
    picture[saturated], picture[dark] = RED, BLUE
    if outline_of is not None:
        from scipy.ndimage import binary_dilation

        picture[binary_dilation(outline_of, np.ones((3, 3), bool)) & ~outline_of] = YELLOW
    return picture
