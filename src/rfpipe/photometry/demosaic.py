"""The colour mosaic of a sensor: sampling an image through it, and filling the gaps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.units import RADIANCE

if TYPE_CHECKING:
    from scipy.sparse import csr_array


# Bilinear weights for red, green and blue, of the photosite itself, its direct and its diagonal
# neighbours, if they have the colour.
_WEIGHTS = ((1, 0.5, 0.25), (1, 0.25, 0), (1, 0.5, 0.25))


def check_mosaic(camera_shape: tuple[int, ...], channels: int) -> None:
    """Raise InputError if images of this shape can't be sampled through a colour mosaic."""
    if channels != 3 or min(camera_shape[-2:]) < 2:
        raise InputError(
            f"a Bayer mosaic needs 3 channels of at least 2 x 2 pixels, not {channels} of "
            f"{camera_shape[-2:]}",
            remedy="set bayer to null",
        )


def mosaic(image: Float, pattern: str) -> Float:
    """Sample an image (*camera_shape, 3) at each photosite's own colour, (*camera_shape)."""
    colour = _sampled(image.shape[-3:-1], pattern).argmax(axis=0)
    return np.take_along_axis(image, np.broadcast_to(colour, image.shape[:-1])[..., None], -1)[
        ..., 0
    ]


def demosaic(radiance: Float, variance: Float, pattern: str) -> tuple[Float, Float]:
    """Interpolate the missing colours of a radiance image, with the variance of the result.

    Bilinear interpolation is linear, as a transport matrix requires, and doesn't overshoot. It
    spreads light that falls on few photosites, and the light loses its colour [B.2]; see
    `normalize`.

    Parameters
    ----------
    radiance, variance : ndarray of float32, shape (..., H, W)
    pattern : str
        RGGB, BGGR, GRBG or GBRG: colours of the photosites (0, 0), (0, 1), (1, 0), (1, 1).

    Returns
    -------
    radiance, variance : ndarray of float32, shape (..., H, W, 3)
        Noise of adjacent samples is correlated; the variance is for single samples.
    """
    shape = radiance.shape[-2:]
    weights = filling(shape, pattern)
    squares = [matrix.power(2) for matrix in weights]
    filled, spread = (
        weighed(matrices, samples.reshape(-1, prod(shape), 1)).reshape(*samples.shape, 3)
        for matrices, samples in ((weights, radiance), (squares, variance))
    )
    return filled, spread


@lru_cache(maxsize=4)
def filling(shape: tuple[int, int], pattern: str) -> tuple[csr_array[Any], ...]:
    """Matrices of the interpolation, float32 (H W, H W) for red, green and blue.

    At the border, the image is mirrored about its outermost pixels, which preserves the pattern of
    the mosaic. The package colour-demosaicing gives equal results except at the border, where it
    repeats the outermost pixels, and red is 2.25 times too bright in a corner.
    """
    from scipy.sparse import csr_array

    height, width = shape
    photosite = np.pad(np.arange(height * width).reshape(shape), 1, mode="reflect")
    matrices = []
    for mask, weights in zip(_sampled(shape, pattern), _WEIGHTS, strict=True):
        parts = []
        for y, x in product(range(3), repeat=2):
            source = photosite[y : y + height, x : x + width].ravel()
            weight = weights[abs(y - 1) + abs(x - 1)]
            used = np.flatnonzero(mask.ravel()[source]) if weight else np.zeros(0, np.int64)
            parts.append((np.full(len(used), weight, np.float32), used, source[used]))
        values, rows, columns = map(np.concatenate, zip(*parts, strict=True))
        matrices.append(csr_array((values, (rows, columns)), shape=(height * width,) * 2))
    return tuple(matrices)


def weighed(matrices: Sequence[csr_array[Any]], images: NDArray[Any]) -> Float:
    """Apply one matrix to each channel of images (B, pixels, C), or all to a single channel.

    Returns float32 (B, rows, matrices). Images are processed one by one, so that the bits of a
    result don't depend on the batch.
    """
    out = np.empty((len(images), matrices[0].shape[0], len(matrices)), RADIANCE)
    for image, result in zip(images, out, strict=True):
        for channel, matrix in enumerate(matrices):
            source = image[:, min(channel, images.shape[-1] - 1)]
            result[:, channel] = matrix @ np.ascontiguousarray(source, RADIANCE)
    return out


def _sampled(shape: tuple[int, ...], pattern: str) -> NDArray[np.bool_]:
    """Masks of the red, green and blue photosites, (3, H, W)."""
    sampled = np.zeros((3, *shape), bool)
    for position, colour in enumerate(pattern):
        y, x = divmod(position, 2)
        sampled["RGB".index(colour), y::2, x::2] = True
    return sampled
