"""Separation of a picture into direct, near-range and far-range light, by distance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.transport.algebra import MatrixAlgebra
from rfpipe.transport.correspondence import correspondence_of

Places = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Separation:
    """Three pictures, float32 (*camera_shape, channels), whose sum is the relit picture.

    Attributes
    ----------
    direct, near, far
        Light from projector rays around the place that lights a pixel directly, from rays near
        that place, and from all other rays.
    """

    direct: Float
    near: Float
    far: Float


def separated(
    transport: MatrixAlgebra, light: Float, direct: int, near: float, noise: Float | None = None
) -> Separation:
    """Separate the picture under planar light (channels, projector rays).

    See `Relightable.separate`, and `correspondence_of` for `noise`.
    """
    shape = transport.projector_shape
    if not (direct >= 0 and direct == int(direct) and 0 < near <= 1):
        raise InputError(
            f"direct = {direct}, near = {near}; expected an integer of at least 0, and a share of "
            "the projector's longer side, above 0 and at most 1"
        )
    if min(shape[-2:]) < 2:
        raise InputError(
            f"the projector's rays {shape} are single lights, without a range; separate a "
            "transport whose projector shows pictures"
        )
    places = _places(transport, noise)
    channels = range(transport.channels)
    planes = light.reshape(-1, *shape[-2:])
    windows = (_windows(plane, places, int(direct)) for plane in planes)
    around = np.stack([transport.relight_per_ray(light, k) for k, light in enumerate(windows)])
    within = np.zeros_like(around)
    for weights, lit in _neighbourhoods(planes, places, near * max(shape), direct + 1):
        images = transport.forward(lit.reshape(-1, *light.shape), channels)
        within += (weights[:, None] * images).sum(axis=0)
    image = transport.forward(light[None], channels)[0]
    parts = (around, within - around, image - within)
    return Separation(*(it.T.reshape(*transport.camera_shape, -1) for it in parts))


def _places(transport: MatrixAlgebra, noise: Float | None) -> Places:
    """Return row and column of the place that lights each camera ray directly, (M, 2)."""
    from scipy.ndimage import distance_transform_edt

    correspondence = correspondence_of(transport, noise)
    mask = correspondence.mask
    if not mask.any():
        raise InputError(
            "no camera pixel has a confident place in the projector's picture; separation needs "
            "direct light"
        )
    nearest = distance_transform_edt(~mask, return_distances=False, return_indices=True)
    places: Places = correspondence.places[tuple(nearest)]
    if transport.camera_shape == transport.projector_shape:
        rays = np.moveaxis(np.indices(mask.shape)[-2:], 0, -1) + 0.5
        if np.median(np.abs(places - rays)) < 0.5:  # coaxial
            places = rays
    return places.reshape(-1, 2)


def _windows(light: Float, places: Places, reach: int) -> Any:
    """Return the light around each camera ray's place, sparse (M, N)."""
    from scipy.sparse import csr_array

    side = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    sent = np.floor(places[:, None]).astype(np.int64) + offsets
    inside = ((sent >= 0) & (sent < light.shape)).all(axis=-1)
    owner, ray = np.nonzero(inside)[0], np.ravel_multi_index(sent[inside].T, light.shape)
    windows = csr_array((light.ravel()[ray], (owner, ray)), shape=(len(places), light.size))
    windows.eliminate_zeros()
    return windows


def _neighbourhoods(
    light: Float, places: Places, near: float, least: int
) -> Iterator[tuple[Float, Float]]:
    """Divide the projector's picture into overlapping neighbourhoods.

    Yields
    ------
    weights : ndarray of float32, shape (B, M)
        Of camera rays, by linear interpolation between grid points at distances of `near`.
    lit : ndarray of float32, shape (B, channels, height, width)
        The light at a distance of at most `near` and `least` from each grid point.
    """
    shares, boxes, spacing = [], [], max(1.0, near)
    for axis, length in enumerate(light.shape[1:]):
        points = spacing * np.arange(np.ceil(length / spacing) + 1)[:, None]
        distance = np.abs(places[:, axis] - points) / spacing
        shares.append(np.maximum(1 - distance, 0).astype(np.float32))
        boxes.append(np.abs(np.arange(length) + 0.5 - points) <= spacing + least)
    for share, box in zip(shares[0], boxes[0], strict=True):
        yield share * shares[1], light * (box[:, None] & boxes[1][:, None])[:, None]
