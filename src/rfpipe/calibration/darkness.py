"""What the all-off picture is made of: the sensor's own current, light of the room, the lamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rfpipe.calibration.sight import Sight

__all__ = ["Glow", "beyond_neighbours", "measure_glow"]

Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_CURRENT = 1e4
"""Electrons a second, the most that the dark current of a camera's sensor is taken for: good ones
have a few at room temperature, poor and hot ones a thousand."""

STRUCTURED = 0.1
"""Of the projector's black, what its shape leaves unexplained by an imperfect white picture."""

SIGNIFICANCE = 5.0
BAND = 2
"""Camera pixels on either side of the projector's outline that are compared across it."""

LEAST_PIXELS = 40
"""On either side of it."""


@dataclass(frozen=True)
class Glow:
    """What comes with the exposure time in the dark; counts a second, unless said otherwise.

    Attributes
    ----------
    even, even_error : float
        The same all over the picture: dark current, or light that falls evenly.
    uneven : float
        Of the picture's structure that the projector doesn't explain, 95th percentile: light on
        what is seen, or of another lamp.
    black, black_error : float
        Of the projector's full light that it gives where it should be off, a fraction.
    at_outline : bool
        Whether that was known by a step at the projector's outline, where surfaces go on and room
        light does, too.
    room : float
        Even and uneven light, without what can be dark current; 0 where it can be.
    of_white : float
        Room light over the projector's, means over what it lights, a fraction; NaN without light.
    """

    even: float
    even_error: float
    uneven: float
    black: float
    black_error: float
    at_outline: bool
    room: float
    of_white: float


def measure_glow(
    rate: Double, error: Double, good: Mask, sight: Sight, electrons_per_count: float
) -> Glow:
    """Tell apart what fills the all-off picture.

    Parameters
    ----------
    rate, error : ndarray of float64, shape (H, W)
        Counts a second under the all-off picture, and their standard error.
    good : ndarray of bool, shape (H, W)
        Photosites to believe: not hot, not saturated.
    sight : Sight
    electrons_per_count : float
        As well as it is known; a sensor's dark current is told from light by it.

    Notes
    -----
    Dark current and light both grow with the exposure time. Light of the projector has the shape
    of its own white picture: a regression on that, or the step at the outline where the camera
    sees beyond it. What is left is even or not; a sensor's current is even but for hot
    photosites, and small.
    """
    white = sight.white.astype(np.float64)
    at = good & np.isfinite(rate)
    if at.sum() < LEAST_PIXELS:
        return Glow(0.0, float("inf"), 0.0, 0.0, float("inf"), False, 0.0, float("nan"))
    even, black, black_error = _regression(white[at], rate[at], error[at])
    stepped = _step(rate, error, white, sight.lit, at)
    if stepped is not None:
        black, black_error = stepped
    if not (black > SIGNIFICANCE * black_error and sight.lit.any()):
        black = 0.0
    rest = rate[at] - black * white[at]
    even = float(np.median(rest))
    even_error = float(1.2533 * np.median(error[at]) / np.sqrt(at.sum()))
    beyond = np.percentile(np.abs(rest - even), 95) ** 2 - (2 * np.median(error[at])) ** 2
    uneven = float(np.sqrt(max(beyond, 0.0)))
    least = max(float(np.median(error[at])), STRUCTURED * black * float(white[at].max()))
    uneven = uneven if uneven > least else 0.0
    can_be_current = even * electrons_per_count <= MOST_CURRENT
    room = (0.0 if can_be_current else max(even, 0.0)) + uneven
    lit = at & sight.lit
    light = float(white[lit].mean()) if lit.any() else 0.0
    return Glow(
        even,
        even_error,
        uneven,
        float(black),
        float(black_error),
        stepped is not None,
        room,
        room / light if light > 0 else float("nan"),
    )


def beyond_neighbours(image: Double, reach: int) -> Double:
    """Return by how much each pixel exceeds all its neighbours, or stays below; else 0.

    Parameters
    ----------
    image : ndarray of float64, shape (H, W)
    reach : int
        Pixels to the next neighbour: 1, or 2 under a colour mosaic.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    ring = np.zeros((2 * reach + 1,) * 2, bool)
    ring[::reach, ::reach] = True
    ring[reach, reach] = False
    low = minimum_filter(image, footprint=ring, mode="mirror")
    high = maximum_filter(image, footprint=ring, mode="mirror")
    return np.asarray(image - np.clip(image, low, high))


def _regression(x: Double, y: Double, error: Double) -> tuple[float, float, float]:
    """Fit y = a + b x, outliers left out; return a, b and the error of b by the true spread."""
    kept = np.ones(x.shape, bool)
    a, b, b_error = float(np.median(y)), 0.0, float("inf")
    for _ in range(3):
        spread = float(np.var(x[kept]))
        if not spread > 0:
            break
        b = float(np.cov(x[kept], y[kept])[0, 1] / spread)
        a = float(y[kept].mean() - b * x[kept].mean())
        rest = y - a - b * x
        deviation = max(float(rest[kept].std()), float(np.median(error)))
        # neighbours share what the model doesn't know: a quarter of the pixels are independent
        b_error = deviation / float(np.sqrt(spread * max(kept.sum() / 4, 1)))
        kept = np.abs(rest) < 4 * deviation
    return a, b, b_error


def _step(
    rate: Double, error: Double, white: Double, lit: Mask, at: Mask
) -> tuple[float, float] | None:
    """Return the projector's black by the step at its outline, with its error; None without one."""
    from scipy.ndimage import binary_dilation, binary_erosion

    square: NDArray[Any] = np.ones((3, 3), bool)
    # pixels on the outline itself are lit in part
    inner = binary_erosion(lit, square, iterations=1, border_value=1)
    inside = inner & ~binary_erosion(inner, square, iterations=BAND, border_value=1) & at
    outer = ~binary_dilation(lit, square, iterations=1)
    outside = outer & binary_dilation(lit, square, iterations=1 + BAND) & at
    if min(inside.sum(), outside.sum()) < LEAST_PIXELS:
        return None
    rise = white[inside].mean() - white[outside].mean()
    if not rise > 0:
        return None
    jump = rate[inside].mean() - rate[outside].mean()
    spread = sum(
        max(float(rate[part].var()), float(np.square(error[part]).mean())) / part.sum()
        for part in (inside, outside)
    )
    return float(jump / rise), float(np.sqrt(spread) / rise)
