"""The colour mosaic of a sensor: sampling an image through it, and filling the gaps."""

from __future__ import annotations

from functools import lru_cache
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
    shape = radiance.shape[-2:]
    planes = demosaic_matrices(shape, pattern), _squares(shape, pattern)
    colour, spread = (
        _filled(image, matrices)
        for image, matrices in zip((radiance, variance), planes, strict=True)
    )
    return colour, spread


@lru_cache(maxsize=2)
def demosaic_matrices(shape: tuple[int, ...], pattern: str) -> tuple[csr_array[Any], ...]:
    """Return `demosaic` of one view as matrices, one for each colour.

    Parameters
    ----------
    shape : tuple of int
        Height and width, at least 2 each.
    pattern : str
        One of `BAYER_PATTERNS`.

    Returns
    -------
    tuple of 3 csr_array of float32, shape (H W, H W)
        From photosites to pixels; rows sum to 1.
    """
    colours = np.empty(shape, "<U1")
    for position, colour in enumerate(pattern):
        y, x = divmod(position, 2)
        colours[y::2, x::2] = colour
    return tuple(_filling(colours, colour) for colour in "RGB")


@lru_cache(maxsize=2)
def _squares(shape: tuple[int, ...], pattern: str) -> tuple[csr_array[Any], ...]:
    """Return `demosaic_matrices` with squared weights, for the variance."""
    return tuple(matrix.power(2) for matrix in demosaic_matrices(shape, pattern))


def _filled(image: Float, matrices: tuple[csr_array[Any], ...]) -> Float:
    """Apply a matrix for each colour to images (..., H, W)."""
    views = np.asarray(image, np.float32).reshape(-1, matrices[0].shape[1])
    colour = np.empty((*views.shape, 3), np.float32)
    for view, filled in zip(views, colour, strict=True):
        for channel, matrix in enumerate(matrices):
            filled[:, channel] = matrix @ view
    return colour.reshape(*image.shape, 3)


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
