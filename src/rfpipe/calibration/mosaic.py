"""Order of the colours in a camera's mosaic: by its greens, and by red, green and blue pictures."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.units import SATURATION_FRACTION

ORDERS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colours of the photosites (0, 0), (0, 1), (1, 0) and (1, 1)."""

_COLOURS = "RGB"
_EQUAL = 0.03  # largest log ratio of two greens
_UNEQUAL = 0.06  # smallest log ratio of a red and a blue photosite
_SIGNIFICANCE = 5.0  # standard errors of a ratio
_CLEARER = 1.1  # light at the photosites of the best order, relative to the next best order
_LEAST_CELLS = 25


class Mosaic(NamedTuple):
    """Order of a mosaic's colours.

    Attributes
    ----------
    orders : tuple of str
        Orders that fit: one, two where only the greens are known, or all four.
    evidence : str
        Description of the measurement.
    """

    orders: tuple[str, ...]
    evidence: str


def mosaic_of(white: Double, colours: Double | None) -> Mosaic:
    """Find the order of a mosaic's colours.

    Parameters
    ----------
    white : ndarray of float64, shape (H, W)
        Counts of a white picture above black; NaN where saturated.
    colours : ndarray of float64, shape (3, H, W), optional
        The same of a red, a green and a blue picture.

    Notes
    -----
    Both greens of a cell of 2 x 2 photosites have equal counts in any light; red and blue seldom
    have. A red picture is brightest at the red photosites.
    """
    if colours is not None:
        light = np.array([[np.nanmean(site) for site in _sites(picture)] for picture in colours])
        # each colour's picture may have another brightness
        share = light / np.maximum(light.sum(axis=1, keepdims=True), 1e-9)
        fits = [
            float(sum(share[_COLOURS.index(name), site] for site, name in enumerate(order)))
            for order in ORDERS
        ]
        best, second = np.argsort(fits)[::-1][:2]
        if fits[best] > _CLEARER * fits[second]:
            places = ", ".join(
                f"{name} light counts most at {divmod(int(share[index].argmax()), 2)}"
                for index, name in ((0, "red"), (2, "blue"))
            )
            return Mosaic((ORDERS[best],), f"of a cell's photosites, {places}")
    return _by_greens(white)


def _by_greens(white: Double) -> Mosaic:
    """Find the orders whose greens are equal in a white picture."""
    sites = _sites(white)
    off, off_error = _log_ratio(sites[1], sites[2])
    on, on_error = _log_ratio(sites[0], sites[3])
    for green, green_error, colour, colour_error, orders, names in (
        (off, off_error, on, on_error, ORDERS[:2], "(0, 0) and (1, 1)"),
        (on, on_error, off, off_error, ORDERS[2:], "(0, 1) and (1, 0)"),
    ):
        is_equal = abs(green) < _EQUAL and green_error < _EQUAL
        if is_equal and abs(colour) > max(_UNEQUAL, _SIGNIFICANCE * colour_error):
            share = float(np.exp(abs(colour)) - 1)
            return Mosaic(
                orders,
                f"the photosites {names} of a cell differ by {share:.0%}, the other two by "
                f"{np.exp(abs(green)) - 1:.1%}, which must be the greens",
            )
    return Mosaic(ORDERS, "the greens cannot be distinguished from red and blue")


def _sites(picture: Double) -> list[Double]:
    """Counts at the photosites (0, 0), (0, 1), (1, 0) and (1, 1) of all cells."""
    height, width = (extent - extent % 2 for extent in picture.shape)
    cells = picture[:height, :width]
    return [cells[row::2, column::2] for row in (0, 1) for column in (0, 1)]


def _log_ratio(first: Double, second: Double) -> tuple[float, float]:
    """Median log ratio of two photosites, and its standard error, infinite if unknown."""
    lit = np.isfinite(first) & np.isfinite(second) & (first > 0) & (second > 0)
    if lit.sum() < _LEAST_CELLS:
        return 0.0, np.inf
    total = first + second
    bright = lit & (total > np.median(total[lit]))
    ratio = np.log(first[bright] / second[bright])
    spread = MAD_TO_DEVIATION * float(np.median(np.abs(ratio - np.median(ratio))))
    # the standard error of a median is 1.2533 times the one of a mean
    return float(np.median(ratio)), 1.2533 * spread / np.sqrt(ratio.size)


def mosaic_facts(
    bayer: str,
    black: NDArray[Any],
    white: NDArray[Any],
    colours: NDArray[Any] | None,
    white_level: int,
) -> dict[str, Any]:
    """Compare the order of a mosaic's colours with the settings, for the step scene.

    Parameters
    ----------
    bayer : str
        Order in the settings.
    black, white : ndarray, shape (E, H, W)
        Counts of the all-off and of the white picture.
    colours : ndarray, shape (3, E, H, W), optional
        Counts of a red, a green and a blue picture.
    white_level : int
        Full scale in counts.
    """
    limit = SATURATION_FRACTION * white_level
    # the longest exposure that leaves most photosites below saturation
    usable = [index for index, frame in enumerate(white) if (frame >= limit).mean() < 0.05]
    at = usable[-1] if usable else 0

    def light(bracket: NDArray[Any]) -> Double:
        frame = bracket[at].astype(np.float64)
        return np.where(frame >= limit, np.nan, frame - black[at])

    primaries = None if colours is None else np.stack([light(bracket) for bracket in colours])
    measured = mosaic_of(light(white), primaries)
    return {
        "bayer": bayer,
        "bayer_orders": " or ".join(measured.orders),
        "bayer_evidence": measured.evidence,
        "is_other_order": int(bayer not in measured.orders),
    }
