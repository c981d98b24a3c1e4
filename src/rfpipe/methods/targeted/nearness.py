"""Where the light of a transport stays near, whatever the rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.transport.base import Transport

__all__ = ["nearness"]

# Rays that send the camera less than this part of the mean ray's light say nothing.
_DIM = 0.01


def nearness(transport: Transport) -> Float:
    """Tell how much of the light that a ray sends reaches pixels from elsewhere, but from near.

    Under a chequerboard a pixel has direct light, and half of the indirect light from beyond a
    square or so; or, under its inverse, the latter alone (S. K. Nayar et al., *Fast separation of
    direct and global components*, SIGGRAPH 2006). Boards of all sizes, relit, tell from how far
    it comes, without knowing which pixel sees which ray.

    Returns
    -------
    ndarray of float32, shape (*projector_shape)
        Share of the light that comes from elsewhere, over the distance in pixels; at least 0.
    """
    shape, channels = transport.projector_shape, range(transport.channels)
    floodlit = _pictures(transport, np.ones((1, *shape), np.float32))[0]
    sides = _sides(shape)
    shares = [_share(_pictures(transport, _boards(shape, side)), floodlit) for side in sides]
    near = np.zeros_like(floodlit)
    shares.append(np.zeros_like(near))
    for side, share, beyond in zip(sides, shares[:-1], shares[1:], strict=True):
        near += np.maximum(share - beyond, 0) / side
    weights = np.stack([near, np.ones_like(near)]).astype(np.float32)[:, None]
    light = np.broadcast_to(weights, (2, transport.channels, len(near)))
    of_near, of_all = transport.adjoint(light, channels).sum(axis=1, dtype=np.float64)
    bright = of_all > max(_DIM * of_all.mean(), 0)
    mean = np.divide(of_near, of_all, out=np.zeros_like(of_all), where=bright)
    image: Float = mean.astype(np.float32).reshape(shape)
    return image


def _sides(shape: tuple[int, ...]) -> list[int]:
    """Return the sides of a board's squares: from 2 rays, doubling, to the image's."""
    longest = max(RayDomain(shape).image_shape)
    return [2**power for power in range(1, longest.bit_length()) if 2**power < longest]


def _boards(shape: tuple[int, ...], side: int) -> Float:
    """Return chequerboards (8, *shape): moved by half a square either way, and their inverses.

    A pixel that sees the edge of two squares has direct light from both: not so of another board.
    """
    height, width = RayDomain(shape).image_shape
    row, column = np.ogrid[:height, :width]
    boards = [
        np.broadcast_to(((row + down) // side + (column + across) // side) % 2, shape)
        for down in (0, side // 2)
        for across in (0, side // 2)
    ]
    lit = np.stack(boards).astype(np.float32)
    return np.concatenate([lit, 1 - lit])


def _pictures(transport: Transport, patterns: Float) -> NDArray[np.float64]:
    """Return relit pictures (P, M), their channels added up."""
    light = patterns.reshape(len(patterns), 1, -1)
    white = np.broadcast_to(light, (len(light), transport.channels, light.shape[-1]))
    relit = transport.forward(white, range(transport.channels))
    images: NDArray[np.float64] = relit.sum(axis=1, dtype=np.float64)
    return images


def _share(pictures: NDArray[np.float64], floodlit: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of each pixel's light that comes from beyond a square of the boards."""
    darkest = 2 * pictures.min(axis=0)
    share = np.divide(darkest, floodlit, out=np.zeros_like(floodlit), where=floodlit > 0)
    clipped: NDArray[np.float64] = share.clip(0, 1)
    return clipped
