"""Order of the colours in a camera's mosaic: by its greens, and by red, green and blue pictures."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.units import SATURATION_FRACTION

Double = NDArray[np.float64]

ORDERS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colours of the photosites (0, 0), (0, 1), (1, 0) and (1, 1)."""

_COLOURS = "RGB"
_EQUAL = 0.03  # log ratio of two greens, at most
_UNEQUAL = 0.06  # log ratio of two photosites, at least, that are no greens
_SURE = 5.0  # standard errors of a ratio
_CLEARER = 1.1  # light at the photosites of the best order over that of the next one
_LEAST_CELLS = 25


class Mosaic(NamedTuple):
    """Order of a mosaic's colours.

    Attributes
    ----------
    orders : tuple of str
        Orders that fit: all four where nothing is known, two where only the greens are.
    evidence : str
        Measurement that shows it.
    """

    orders: tuple[str, ...]
    evidence: str


def mosaic_of(white: Double, colours: Double | None) -> Mosaic:
    """Return the order of a mosaic's colours.

    Parameters
    ----------
    white : ndarray of float64, shape (H, W)
        Counts of a white picture above black; NaN where saturated.
    colours : ndarray of float64, shape (3, H, W), optional
        The same of a red, a green and a blue picture.

    Notes
    -----
    Both greens of a cell of 2 x 2 photosites count alike in any light; red and blue seldom do. A
    red picture is brightest where red is.
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
    """Return the orders whose greens are alike in a white picture."""
    sites = _sites(white)
    off, off_error = _log_ratio(sites[1], sites[2])
    on, on_error = _log_ratio(sites[0], sites[3])
    for alike, error, different, its_error, orders, names in (
        (off, off_error, on, on_error, ORDERS[:2], "(0, 0) and (1, 1)"),
        (on, on_error, off, off_error, ORDERS[2:], "(0, 1) and (1, 0)"),
    ):
        is_alike = abs(alike) < _EQUAL and error < _EQUAL
        if is_alike and abs(different) > max(_UNEQUAL, _SURE * its_error):
            share = float(np.exp(abs(different)) - 1)
            return Mosaic(
                orders,
                f"the photosites {names} of a cell differ by {share:.0%}, the others by "
                f"{np.exp(abs(alike)) - 1:.1%}: these are the greens",
            )
    return Mosaic(ORDERS, "the greens cannot be told from red and blue")


def _sites(picture: Double) -> list[Double]:
    """Return the photosites (0, 0), (0, 1), (1, 0) and (1, 1) of all cells."""
    height, width = (extent - extent % 2 for extent in picture.shape)
    whole = picture[:height, :width]
    return [whole[row::2, column::2] for row in (0, 1) for column in (0, 1)]


def _log_ratio(one: Double, other: Double) -> tuple[float, float]:
    """Return the median log ratio of two photosites, and its error; infinite if unknown."""
    lit = np.isfinite(one) & np.isfinite(other) & (one > 0) & (other > 0)
    if lit.sum() < _LEAST_CELLS:
        return 0.0, np.inf
    bright = lit & (one + other > np.median((one + other)[lit]))
    ratio = np.log(one[bright] / other[bright])
    spread = MAD_TO_DEVIATION * float(np.median(np.abs(ratio - np.median(ratio))))
    # the median's standard error is 1.2533 times the mean's
    return float(np.median(ratio)), 1.2533 * spread / np.sqrt(ratio.size)


def mosaic_facts(
    bayer: str,
    black: NDArray[Any],
    white: NDArray[Any],
    colours: NDArray[Any] | None,
    white_level: int,
) -> dict[str, Any]:
    """Return the facts of a mosaic, for the verdict of the step scene.

    Parameters
    ----------
    bayer : str
        Order that the settings say.
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

    shown = None if colours is None else np.stack([light(bracket) for bracket in colours])
    found = mosaic_of(light(white), shown)
    return {
        "bayer": bayer,
        "bayer_orders": " or ".join(found.orders),
        "bayer_evidence": found.evidence,
        "is_other_order": int(bayer not in found.orders),
    }
