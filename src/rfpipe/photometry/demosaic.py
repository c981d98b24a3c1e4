"""The colour mosaic of a sensor: sampling an image through it, and filling the gaps."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["BAYER_PATTERNS", "check_mosaic", "demosaic", "filled_in", "mosaic"]

Float = NDArray[np.float32]

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colours of the photosites (0, 0), (0, 1), (1, 0), (1, 1)."""

_DIRECT, _DIAGONAL = (0.5, 0.25, 0.5), (0.25, 0.0, 0.25)
"""Bilinear weights in red, green and blue of a pixel's direct and of its diagonal neighbours that
have the colour; its own photosite has a weight of 1."""


def check_mosaic(camera_shape: tuple[int, ...], channels: int) -> None:
    """Raise InputError unless images of this shape can be sampled through a colour mosaic."""
    if channels != 3:
        raise InputError(f"a Bayer mosaic needs 3 channels, not {channels}; set bayer to null")
    if min(camera_shape[-2:]) < 2:
        raise InputError(
            f"a Bayer mosaic needs images of at least 2 x 2 pixels, not {camera_shape[-2:]}; "
            "set bayer to null"
        )


def mosaic(image: Float, pattern: str) -> Float:
    """Sample an image (*camera_shape, 3) at each photosite's own colour, (*camera_shape)."""
    colour = _sampled(image.shape[-3:-1], pattern).argmax(axis=0)
    return np.take_along_axis(image, np.broadcast_to(colour, image.shape[:-1])[..., None], -1)[
        ..., 0
    ]


def demosaic(radiance: Float, variance: Float, pattern: str) -> tuple[Float, Float]:
    """Interpolate the missing colours of a radiance image, with the variance of the result.

    Bilinear: linear, so that light that adds up in the scene adds up in the images, as the
    transport matrix wants, and without overshoot. It still spreads light that falls on few
    photosites and loses its colour [B.2]; see `normalize`.

    Parameters
    ----------
    radiance, variance : ndarray of float32, shape (..., H, W)
    pattern : str
        One of `BAYER_PATTERNS`.

    Returns
    -------
    radiance, variance : ndarray of float32, shape (..., H, W, 3)
        Samples next to each other now share noise; the variance is each one's own.

    Notes
    -----
    Beyond the border the image goes on mirrored about its last pixels, as the pattern does.
    colour-demosaicing, which it agrees with elsewhere, doubles them instead: red comes out 2.25
    times too bright in a corner.
    """
    return _filled(radiance, pattern, 1), _filled(variance, pattern, 2)


def _filled(samples: Float, pattern: str, power: int) -> Float:
    """Interpolate samples (..., H, W), with a power of the weights."""
    views = np.asarray(samples, np.float32).reshape(-1, *samples.shape[-2:])
    filled = np.empty((*views.shape, 3), np.float32)
    weights = _sampled(views.shape[1:], pattern), _DIRECT, _DIAGONAL
    for channel, (own, direct, diagonal) in enumerate(zip(*weights, strict=True)):
        for view, result in zip(views, filled, strict=True):
            around = np.pad(np.where(own, view, np.float32(0)), 1, mode="reflect")
            # a border pixel's two neighbours are one: their weights add up before they're raised
            around[[0, -1]] *= 2**power - 1
            around[:, [0, -1]] *= 2**power - 1
            vertical = around[:-2] + around[2:]
            colour = around[1:-1, :-2] + around[1:-1, 2:]
            colour += vertical[:, 1:-1]
            colour *= direct**power
            colour += around[1:-1, 1:-1]
            if diagonal:
                colour += diagonal**power * (vertical[:, :-2] + vertical[:, 2:])
            result[..., channel] = colour
    return filled.reshape(*samples.shape, 3)


def filled_in(matrix: csr_array[Any], shape: tuple[int, int], pattern: str) -> list[csr_array[Any]]:
    """Return what weighs pixels as what weighs the photosites that `demosaic` fills them from.

    Parameters
    ----------
    matrix : csr_array of float32, shape (n, H W)
    shape : (int, int)
        Height and width, at least 2 each.
    pattern : str
        One of `BAYER_PATTERNS`.

    Returns
    -------
    list of 3 csr_array of float32, shape (n, H W)
        For red, green and blue.
    """
    from scipy.sparse import coo_array

    weighed = matrix.tocoo()
    pixel = np.divmod(weighed.col, shape[1])
    found = []
    for own, direct, diagonal in zip(_sampled(shape, pattern), _DIRECT, _DIAGONAL, strict=True):
        parts = []
        for step in product((-1, 0, 1), repeat=2):
            # mirrored about the border pixel
            y, x = (
                extent - 1 - np.abs(extent - 1 - np.abs(at + by))
                for at, by, extent in zip(pixel, step, shape, strict=True)
            )
            source = y * shape[1] + x
            weight = np.float32((1, direct, diagonal)[np.count_nonzero(step)])
            used = own.ravel()[source] & (weight > 0)
            parts.append((weight * weighed.data[used], weighed.row[used], source[used]))
        values, rows, columns = map(np.concatenate, zip(*parts, strict=True))
        found.append(coo_array((values, (rows, columns)), shape=matrix.shape).tocsr())
    return found


def _sampled(shape: tuple[int, ...], pattern: str) -> NDArray[np.bool_]:
    """Return whether a photosite has the colour red, green or blue, (3, H, W)."""
    sampled = np.zeros((3, *shape), bool)
    for position, colour in enumerate(pattern):
        y, x = divmod(position, 2)
        sampled["RGB".index(colour), y::2, x::2] = True
    return sampled
