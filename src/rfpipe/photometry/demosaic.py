"""The colour mosaic of a sensor: sampling an image through it, and filling the gaps."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["BAYER_PATTERNS", "check_mosaic", "demosaic", "demosaic_matrices", "mosaic"]

Float = NDArray[np.float32]

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colours of the photosites (0, 0), (0, 1), (1, 0), (1, 1)."""

_GREEN = (1.0, 0.25, 0.0)
_RED_AND_BLUE = (1.0, 0.5, 0.25)
"""Bilinear weights of a pixel's own photosite, of its direct neighbours and its diagonal ones."""

MARGIN = 2
"""Pixels of border mirrored before the interpolation: even, so that the pattern continues."""


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
    sampled = np.empty(image.shape[:-1], image.dtype)
    for position, colour in enumerate(pattern):
        y, x = divmod(position, 2)
        sampled[..., y::2, x::2] = image[..., y::2, x::2, "RGB".index(colour)]
    return sampled


def demosaic(radiance: Float, variance: Float, pattern: str) -> tuple[Float, Float]:
    """Interpolate the missing colours of a radiance image, with the variance of the result.

    Bilinear, by colour-demosaicing: linear, so that light that adds up in the scene adds up in
    the images, as the transport matrix wants, and without overshoot. It still spreads light that
    falls on few photosites and loses its colour [B.2]; see `normalize`.

    Parameters
    ----------
    radiance, variance : ndarray of float32, shape (*camera_shape)
    pattern : str
        One of `BAYER_PATTERNS`.

    Returns
    -------
    radiance, variance : ndarray of float32, shape (*camera_shape, 3)
        Samples next to each other now share noise; the variance is each one's own.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of its own deprecated imports
        from colour_demosaicing import demosaicing_CFA_Bayer_bilinear

    views = radiance.reshape(-1, *radiance.shape[-2:])
    colour = np.empty((*views.shape, 3), np.float32)
    for view, filled in zip(views, colour, strict=True):
        # The library mirrors with the border pixel doubled, which shifts the pattern there: red
        # came out 2.25 times too bright in a corner. Mirrored here about the border pixel.
        padded = np.pad(view, MARGIN, mode="reflect")
        inner = demosaicing_CFA_Bayer_bilinear(padded, pattern)
        filled[:] = inner[MARGIN:-MARGIN, MARGIN:-MARGIN]
    spread = _spread_variance(variance.reshape(views.shape), pattern)
    shape = (*radiance.shape, 3)
    return colour.reshape(shape), spread.reshape(shape)


def demosaic_matrices(shape: tuple[int, int], pattern: str) -> list[csr_array[Any]]:
    """Return `demosaic` of one view as matrices, one for each colour.

    Parameters
    ----------
    shape : (int, int)
        Height and width, at least 2 each.
    pattern : str
        One of `BAYER_PATTERNS`.

    Returns
    -------
    list of 3 csr_array of float32, shape (H W, H W)
        From photosites to pixels; rows sum to 1.
    """
    colours = np.empty(shape, "<U1")
    for position, colour in enumerate(pattern):
        y, x = divmod(position, 2)
        colours[y::2, x::2] = colour
    return [_filling(colours, colour) for colour in "RGB"]


def _filling(colours: NDArray[np.str_], colour: str) -> csr_array[Any]:
    """Return the interpolation of one colour as a matrix."""
    from scipy.sparse import coo_array

    height, width = colours.shape
    targets, sources, weights = [], [], []
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            away = abs(dy) + abs(dx)
            weight = _GREEN[away] if colour == "G" else _RED_AND_BLUE[away]
            # mirrored about the border pixel, which then counts twice
            rows = np.pad(np.arange(height), 1, mode="reflect")[1 + dy :][:height]
            columns = np.pad(np.arange(width), 1, mode="reflect")[1 + dx :][:width]
            sampled = colours[np.ix_(rows, columns)].ravel() == colour
            sources.append((rows[:, None] * width + columns).ravel()[sampled])
            targets.append(np.flatnonzero(sampled))
            weights.append(np.full(len(targets[-1]), weight, np.float32))
    at = np.concatenate(targets), np.concatenate(sources)
    matrix = coo_array((np.concatenate(weights), at), shape=(colours.size, colours.size)).tocsr()
    matrix.eliminate_zeros()
    return matrix


def _spread_variance(variance: Float, pattern: str) -> Float:
    """Return the variance of the bilinear interpolation (views, H, W, 3): its weights squared."""
    spread = np.empty((*variance.shape, 3), np.float32)
    for channel, colour in enumerate("RGB"):
        sampled = np.zeros_like(variance)
        for position, name in enumerate(pattern):
            if name == colour:
                y, x = divmod(position, 2)
                sampled[:, y::2, x::2] = variance[:, y::2, x::2]
        if colour == "G":  # a quarter of each of four neighbours
            spread[..., channel] = sampled
            spread[..., channel] += np.float32(1 / 16) * _neighbours(sampled, 1)
            spread[..., channel] += np.float32(1 / 16) * _neighbours(sampled, 2)
        else:  # halfway between two neighbours, along one axis after the other
            along_y = sampled + np.float32(1 / 4) * _neighbours(sampled, 1)
            spread[..., channel] = along_y + np.float32(1 / 4) * _neighbours(along_y, 2)
    return spread


def _neighbours(variance: Float, axis: int) -> Float:
    """Sum of both neighbours' variance; at a border both are the same one: four times its own."""
    values = np.moveaxis(variance, axis, 0)
    total = np.empty_like(values)
    total[1:-1] = values[:-2] + values[2:]
    total[0] = 4 * values[1]
    total[-1] = 4 * values[-2]
    return np.moveaxis(total, 0, axis)
