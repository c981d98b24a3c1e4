"""What a near/far model says of light: its range, its images, and the transport in parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.methods.near_far.model import Model
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.transport.base import Transport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multiscale.transport import MultiscaleTransport, bounced
from rfpipe.transport.sum import SumTransport

__all__ = ["LightRange", "as_transport", "indirect", "light_range"]


def indirect(model: Model, floodlit: Float, light: Float) -> Float:
    """Return the indirect light of patterns (P, N) as images (P, C, N)."""
    basis = model.basis
    images = np.empty((len(light), *floodlit.shape), np.float32)
    for channel, factor in enumerate(floodlit):
        images[:, channel] = bounced(basis, basis.pairs, model.cores[channel], factor, light)
    return images


@dataclass(frozen=True)
class LightRange:
    """Where the indirect light of each pixel comes from.

    Attributes
    ----------
    reach : ndarray of float32, shape (*shape)
        Root mean square distance in pixels: at least half a pixel, at most the image's diagonal,
        which also stands where there is no such light.
    nearness : ndarray of float32, shape (*shape)
        Indirect light's share of the floodlit image, 0 to 1, over its reach.
    down, across : ndarray of float32, shape (*shape)
        Mean direction, not normalized; 0 where there is no such light.
    """

    reach: Float
    nearness: Float
    down: Float
    across: Float


def light_range(shape: tuple[int, ...], model: Model, floodlit: Float) -> LightRange:
    """Find where each pixel's indirect light comes from under floodlight."""
    height, width = RayDomain(shape).image_shape
    row, column = (np.broadcast_to(axis, shape).ravel() for axis in np.ogrid[:height, :width])
    square = row**2 + column**2
    moments = np.stack([np.ones_like(row), row, column, square]).astype(np.float32)
    # sums of large squares cancel
    light, down, across, squares = indirect(model, floodlit, moments).sum(axis=1, dtype=np.float64)
    total = light * square + squares - 2 * (row * down + column * across)
    diagonal = float(height**2 + width**2)
    there = light > 0
    found = np.divide(total, light, out=np.full(len(row), diagonal), where=there)
    reach = np.sqrt(np.clip(found, 0.25, diagonal))
    white = floodlit.sum(axis=0, dtype=np.float64)
    share = np.divide(light, white, out=np.zeros_like(light), where=white > 0)
    images = (
        reach,
        np.clip(share, 0, 1) / reach,
        np.where(there, down - row * light, 0),
        np.where(there, across - column * light, 0),
    )
    return LightRange(*(image.astype(np.float32).reshape(shape) for image in images))


def as_transport(
    shape: tuple[int, ...],
    rows: list[dict[str, Any]],
    model: Model | None,
    pictures: Pictures,
    more: Sequence[Transport] = (),
) -> SumTransport:
    """Return direct light, near-range and far-range light where there is any, as a sum.

    Direct is what the floodlit image has and the other parts don't, so that rows have the energy
    that was measured; of pixels that the pictures don't show it stays dark.

    Parameters
    ----------
    shape : tuple of int
    rows : list of dict
        The table of levels.
    model : Model or None
        None before there is one: all light counts as direct.
    pictures : Pictures
    more : sequence of Transport
        Other parts of indirect light.
    """
    parts = [*(() if model is None else _parts(shape, model, pictures)), *more]
    everything = np.ones((1, pictures.channels, pictures.floodlit.shape[1]), np.float32)
    direct = pictures.floodlit.copy()
    for part in parts:
        direct -= part.forward(everything, range(pictures.channels))[0]
    return SumTransport([_direct(shape, direct * pictures.known), *parts], rows)


def _parts(shape: tuple[int, ...], model: Model, pictures: Pictures) -> Iterator[Transport]:
    """Yield near-range and far-range light, where there is any."""
    basis = model.basis
    near = basis.is_near(*basis.pairs)
    for chosen in (near, ~near):
        found: NDArray[np.bool_] = chosen & model.cores.any(axis=0)
        if not found.any():
            continue
        pairs = np.stack([basis.first[found], basis.second[found]])
        arrays = {
            "factor": pictures.floodlit,
            "functions": basis.functions,
            "pairs": pairs,
            "cores": np.ascontiguousarray(model.cores[:, found]),
        }
        yield MultiscaleTransport(shape, pictures.channels, [], arrays)


def _direct(shape: tuple[int, ...], diagonal: Float) -> LowRankTransport:
    channels, rays = diagonal.shape
    arrays = {
        "diagonal": diagonal.astype(np.float32),
        "left": np.zeros((channels, 0, rays), np.float32),
        "strengths": np.zeros((channels, 0), np.float32),
    }
    return LowRankTransport(shape, shape, channels, [], arrays)
