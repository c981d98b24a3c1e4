"""Displacement of pictures on the rays of a coaxial rig: mirrored, shifted, or in place.

Correlation of the pictures y with random patterns s, displaced by D:

    c(D) = <D s, r> / (|s| |r|),    r = 2 y - f

====== ============ ========= ===========================================================
symbol code         shape     meaning
====== ============ ========= ===========================================================
s      signs        (n, H, W) 1 where a pattern is lit, else -1
y      pictures     (n, H, W) radiance under the patterns
f      floodlit     (H, W)    radiance under the all-on pattern
r      response     (n, H, W) radiance under s
c      correlations scalar    largest for the displacement D of the pictures
====== ============ ========= ===========================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double

_MAX_SHIFT = 3
"""Largest shift that is tried, in rays along each axis."""

_CLEAR_FACTOR = 2.0
"""Factor by which the correlation with a displaced pattern must exceed that in place."""

_SIGNIFICANCE = 8.0
"""Standard deviations of a correlation by chance that the correlation must exceed."""

_OWN_SHARE = 0.3
"""Share of a ray's light that must change with the ray's pattern for the ray to be projected."""

_LIT_SHARE = 0.01
"""Share of the mean light from which a ray counts as lit."""

_MIN_MISSED, _MIN_PROJECTED = 0.9, 0.7
"""Shares of lit rays: not projected, at a missed edge; projected, in the remaining picture."""

_MAX_MISSED = 0.05
"""Share of rows or columns at an edge that the projector may miss."""


class Placement(NamedTuple):
    """Displacement of the pictures of random patterns.

    Attributes
    ----------
    name : str
        Such as "mirrored left to right" or "shifted by 1 ray right"; "" for pictures in place.
    missed : float
        Share of rows or columns at one edge whose rays have light, but not from their own pattern.
    edge : str
        That edge: "top", "right", "bottom" or "left".
    """

    name: str = ""
    missed: float = 0.0
    edge: str = ""

    @property
    def text(self) -> str:
        """Description of a displacement or missed edge, "" for none."""
        if self.name:
            return f"its pictures are {self.name}"
        if self.missed > _MAX_MISSED:
            return (
                f"{self.missed:.0%} of the rays, at the {self.edge} edge, get no light of their "
                "own: the projector misses a part of its picture"
            )
        return ""


def placement_of(signs: Double, pictures: Double, floodlit: Double) -> Placement:
    """Correlate pictures of random patterns with these patterns, mirrored and shifted.

    Parameters
    ----------
    signs : ndarray of float64, shape (n, H, W)
        1 where a pattern is lit, else -1.
    pictures, floodlit : ndarray of float64, shapes (n, H, W) and (H, W)
        Radiance, summed over channels.
    """
    response = 2 * pictures - floodlit
    norm = float(np.sqrt(np.square(response).sum() * signs.size))
    if norm == 0:
        return Placement()
    correlations = {
        name: product / norm for name, product in _products_with_displaced(signs, response)
    }
    best = max(correlations, key=lambda name: correlations[name])
    threshold = max(_CLEAR_FACTOR * correlations[""], _SIGNIFICANCE / np.sqrt(signs.size))
    name = best if correlations[best] > threshold else ""
    if name:
        return Placement(name)
    is_lit = floodlit > _LIT_SHARE * floodlit.mean()
    is_projected = (signs * response).mean(axis=0) > _OWN_SHARE * floodlit
    return Placement("", *_missed_edge(is_lit, is_projected))


def _missed_edge(is_lit: NDArray[np.bool_], is_projected: NDArray[np.bool_]) -> tuple[float, str]:
    """Return the largest share of rows or columns that the projector misses, and their edge."""
    largest = 0.0, ""
    for edge, turns in (("top", 0), ("right", 1), ("bottom", 2), ("left", 3)):
        lit = np.rot90(is_lit, turns).sum(axis=1)
        missing = np.rot90(is_lit & ~is_projected, turns).sum(axis=1)
        is_missed = (lit > 0) & (missing >= _MIN_MISSED * lit)
        count = len(lit) if is_missed.all() else int(np.argmin(is_missed))
        remainder = np.rot90(is_projected, turns)[count:]
        if count and remainder.size and remainder.mean() > _MIN_PROJECTED:
            largest = max(largest, (count / len(lit), edge))
    return largest


def _products_with_displaced(signs: Double, response: Double) -> Iterator[tuple[str, float]]:
    """Yield ``<D s, r>`` of the patterns in place, mirrored and shifted, with names of each D."""
    yield "mirrored left to right", float(np.vdot(signs[:, :, ::-1], response))
    yield "mirrored top to bottom", float(np.vdot(signs[:, ::-1], response))
    yield "turned upside down", float(np.vdot(signs[:, ::-1, ::-1], response))
    products = _products_with_shifted(signs, response)
    shifts = range(-_MAX_SHIFT, _MAX_SHIFT + 1)
    for down, right in ((down, right) for down in shifts for right in shifts):
        if abs(down) < signs.shape[1] and abs(right) < signs.shape[2]:
            name = f"shifted by {_shift(down, 'down', 'up')}{_shift(right, 'right', 'left')}"
            yield name.rstrip() if down or right else "", float(products[down, right])


def _products_with_shifted(signs: Double, response: Double) -> Double:
    """Compute ``<D s, r>`` for all periodic shifts D, (H, W), by the convolution theorem."""
    from scipy.fft import irfft2, rfft2

    height, width = signs.shape[1:]
    spectrum = np.zeros((height, width // 2 + 1), np.complex128)
    for pattern, image in zip(signs, response, strict=True):
        spectrum += np.conj(rfft2(pattern)) * rfft2(image)
    return np.asarray(irfft2(spectrum, s=(height, width)))


def _shift(rays: int, positive: str, negative: str) -> str:
    """Describe a shift along one axis, "" for none."""
    unit = "rays" if abs(rays) > 1 else "ray"
    return f"{abs(rays)} {unit} {positive if rays > 0 else negative} " if rays else ""
