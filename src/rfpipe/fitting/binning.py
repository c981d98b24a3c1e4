"""Averages over squares of pixels, and the bins that let a fit stay within memory."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float

# Bytes of a fit, measured on Gray code: for each camera pixel and picture of a channel, for each
# camera pixel besides, and for each projector ray and picture.
_BYTES_PER_SAMPLE = 24
_BYTES_PER_PIXEL = 2500
_BYTES_PER_RAY_SAMPLE = 40
# Share of the memory for the camera's side, and for the projector's.
_CAMERA_SHARE, _PROJECTOR_SHARE = 0.5, 0.25


@dataclass(frozen=True)
class Bins:
    """Sides of the squares of pixels that are averaged.

    Attributes
    ----------
    camera, projector : int
        In pixels; 1 keeps all pixels.
    """

    camera: int
    projector: int


def binned_shape(shape: tuple[int, int], side: int) -> tuple[int, int]:
    """Return the shape of an image after binning; squares at the lower and right edge are cut."""
    return ceil(shape[0] / side), ceil(shape[1] / side)


def bin_image(
    image: NDArray[np.floating], side: int, known: NDArray[np.bool_] | None = None
) -> Float:
    """Average an image over squares of pixels.

    Parameters
    ----------
    image : ndarray of float, shape (H, W) or (H, W, C)
    side : int
        Of a square, in pixels.
    known : ndarray of bool, shape (H, W), optional
        Pixels that count. A square without any is 0.

    Returns
    -------
    ndarray of float32, shape (ceil(H / side), ceil(W / side)[, C])
    """
    image = np.asarray(image, np.float32)
    if known is None or known.all():
        known = np.ones(image.shape[:2], np.bool_)
    else:
        image = image * known.reshape(known.shape + (1,) * (image.ndim - 2))
    count = count_known(known, side).reshape(
        *binned_shape(known.shape, side), *[1] * (image.ndim - 2)
    )
    total = _sums(image, side)
    return np.divide(total, count, out=np.zeros_like(total), where=count > 0, dtype=np.float32)


def count_known(known: NDArray[np.bool_], side: int) -> NDArray[np.int64]:
    """Count the known pixels of each square, int64 (ceil(H / side), ceil(W / side))."""
    return np.rint(_sums(known.astype(np.float32), side)).astype(np.int64)


def proposed_bins(
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    samples: int,
    memory_bytes: float,
) -> Bins:
    """Return the smallest bins for which a fit stays within memory.

    Parameters
    ----------
    camera_shape, projector_shape : (int, int)
        In pixels.
    samples : int
        Pictures times one more than their channels.
    memory_bytes : float
    """
    pixels = _CAMERA_SHARE * memory_bytes / (_BYTES_PER_SAMPLE * samples + _BYTES_PER_PIXEL)
    rays = _PROJECTOR_SHARE * memory_bytes / (_BYTES_PER_RAY_SAMPLE * samples)
    return Bins(_side(camera_shape, pixels), _side(projector_shape, rays))


def _side(shape: tuple[int, int], limit: float) -> int:
    """Return the smallest side of squares that divides an image into at most a number of them."""
    side = 1
    while np.prod(binned_shape(shape, side)) > max(limit, 1):
        side += 1
    return side


def _sums(image: Float, side: int) -> Float:
    """Sum over squares of pixels."""
    if side == 1:
        return image
    rows = np.add.reduceat(image, np.arange(0, image.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, image.shape[1], side), axis=1)
