"""The blur of lens and projector, from the contrast that stripes lose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.codes import COARSER
from rfpipe.calibration.correspondence import Correspondence
from rfpipe.calibration.mapping import SmoothMap
from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.rigs.geometry import pixel_middles

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["blurring", "fit_blur"]

Double = NDArray[np.float64]

NEAR = 1.0
"""Distance in camera pixels' steps on the projector within which a pixel belongs to a map."""

REACH = 4.0
"""Standard deviations that a blur reaches."""

SIGNIFICANCE = 3.0


def fit_blur(correspondence: Correspondence, maps: Sequence[SmoothMap]) -> tuple[float, float]:
    """Measure the blur as that of a Gaussian, the same all over the picture.

    Parameters
    ----------
    correspondence : Correspondence
    maps : sequence of SmoothMap
        From the camera to the projector, of each view.

    Returns
    -------
    blur, error : float
        Standard deviation in camera pixels, 0 where it isn't significant; standard error of its
        square.

    Notes
    -----
    A Gaussian of deviation s takes ``exp(-2 pi^2 s^2 / P^2)`` of the amplitude of stripes of period
    P, a pixel's extent a ``sinc(a / P)``. The amplitude at P over that at 2 P needs neither the
    surface's albedo nor the indirect light, which stripes don't modulate.
    """
    shape = correspondence.valid.shape
    points = pixel_middles(shape)
    squares = []
    for to_projector in maps:
        right, down = np.array([0.5, 0]), np.array([0, 0.5])
        ahead = to_projector(points + right) - to_projector(points - right)
        below = to_projector(points + down) - to_projector(points - down)
        step = np.sqrt(np.square(ahead) + np.square(below))
        distance = np.linalg.norm(correspondence.points - to_projector(points), axis=-1)
        own = correspondence.valid & (distance < NEAR * step.max(axis=-1))
        for axis, contrast in enumerate(correspondence.contrast):
            chosen = own & (contrast > 0)
            extents = np.stack([ahead[chosen, axis], below[chosen, axis], np.ones(chosen.sum())])
            period = float(correspondence.period_pixels)
            sharp = np.sinc(extents / period).prod(axis=0)
            coarse = np.sinc(extents / (COARSER * period)).prod(axis=0)
            lost = np.log(sharp / coarse / contrast[chosen])
            factor = 2 * np.pi**2 * (1 - COARSER**-2) / period**2
            squares.append(lost / factor / np.square(step[chosen, axis]))
    values = np.concatenate(squares)
    if not values.size:
        return 0.0, float("inf")
    square = float(np.median(values))
    spread = MAD_TO_DEVIATION * float(np.median(np.abs(values - square)))
    error = 1.2533 * spread / float(np.sqrt(values.size))
    return (float(np.sqrt(square)) if square > SIGNIFICANCE * error else 0.0), error


def blurring(shape: tuple[int, int], blur: float) -> csr_array[Any]:
    """Return a Gaussian blur of a picture as a matrix (H W, H W); past its edge all is dark."""
    from scipy.linalg import toeplitz
    from scipy.sparse import csr_array, kron
    from scipy.special import ive

    reach = 1 + int(np.ceil(REACH * blur))
    offsets = np.arange(-reach, reach + 1)
    # Lindeberg's discrete Gaussian: its variance is exact, where sampled ones' is less
    weights = ive(offsets, blur**2)
    weights /= weights.sum()
    rows, columns = (toeplitz(np.pad(weights[reach:], (0, extent))[:extent]) for extent in shape)
    return csr_array(kron(csr_array(rows), csr_array(columns), format="csr"))
