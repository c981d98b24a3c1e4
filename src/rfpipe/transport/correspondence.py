"""Which place of the projector lights each camera pixel directly, told by the transport itself.

Direct light comes from few rays that lie together, indirect light from all around. Stripes tell
where the former lie: each coarse pattern of a Gray code is combined with the finest one, so that
all have fine stripes, and indirect light is the same under either half of them [Gupta et al., A
practical approach to 3D scanning in the presence of interreflections, subsurface scattering and
defocus, IJCV 2013]. Around that place, dots so far apart that one is near tell single entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.gray_code import gray_bits, gray_code, gray_number
from rfpipe.transport.algebra import MatrixAlgebra

Float = NDArray[np.float32]

_APART = 8  # pixels between dots; half as many around the place are looked at
_NEAR = 2  # pixels around the brightest entry whose mean place is taken
_LEAST = 0.1  # of a pixel's light, that comes from there


@dataclass(frozen=True)
class Correspondence:
    """What sees what.

    Attributes
    ----------
    places : ndarray of float32, shape (*camera_shape, 2)
        Row and column in the projector's picture, in pixels from its upper left corner: the first
        pixel's middle is at one half.
    confidence : ndarray of float32, shape (*camera_shape)
        Share of a pixel's floodlit light that comes from within two pixels of there, 0 to 1.
    mask : ndarray of bool, shape (*camera_shape)
        Where that is at least a tenth, and the pixel has a thousandth of the brightest's light.
    """

    places: Float
    confidence: Float
    mask: NDArray[np.bool_]


def correspondence_of(transport: MatrixAlgebra) -> Correspondence:
    """Find the place of the projector that lights each camera pixel directly.

    Parameters
    ----------
    transport : Light
        Its projector has one picture.

    Raises
    ------
    InputError
        If the projector is a stack of views, or no light arrives.
    """
    shape = transport.projector_shape
    if RayDomain(shape).views > 1:
        raise InputError(f"the projector's rays {shape} are several views; crop one of them first")
    floodlit = _relit(transport, np.ones((1, *shape), np.float32))[0]
    if not floodlit.max() > 0:
        raise InputError("no pixel sees light of the projector: there is nothing to tell places by")
    coarse = [_coordinate(transport, floodlit, axis) for axis in (0, 1)]
    entries = _around(transport, coarse)
    # light from everywhere, which all dots have alike
    entries -= np.median(entries, axis=(0, 1))
    offset = np.arange(_APART) - _APART // 2
    best = np.argmax(entries.reshape(_APART**2, -1), axis=0)
    brightest = [offset[each] for each in np.unravel_index(best, (_APART, _APART))]
    near = [np.abs(offset[:, None] - each) <= _NEAR for each in brightest]
    weight = np.maximum(entries, 0) * near[0][:, None] * near[1][None]
    light = weight.sum(axis=(0, 1), dtype=np.float64)
    share = np.divide(light, floodlit, out=np.zeros_like(light), where=floodlit > 0)
    places = [
        middle + 0.5 + np.tensordot(offset, weight.sum(axis=1 - axis), 1) / np.maximum(light, 1e-30)
        for axis, middle in enumerate(coarse)
    ]
    camera = transport.camera_shape
    confidence = np.clip(share, 0, 1).astype(np.float32).reshape(camera)
    mask = (confidence >= _LEAST) & (floodlit > 1e-3 * floodlit.max()).reshape(camera)
    return Correspondence(
        np.stack(places, axis=-1).astype(np.float32).reshape(*camera, 2), confidence, mask
    )


def _relit(transport: MatrixAlgebra, patterns: Float) -> Float:
    """Return the pictures, all channels together, (P, camera rays)."""
    channels = range(transport.channels)
    planar = patterns.reshape(len(patterns), 1, -1).repeat(len(channels), axis=1)
    images: Float = transport.forward(planar, channels).sum(axis=1)
    return images


def _coordinate(transport: MatrixAlgebra, floodlit: Float, axis: int) -> NDArray[np.int64]:
    """Return the row, or the column, of each camera pixel's place, to a pixel, (camera rays,)."""
    shape = transport.projector_shape[-2:]
    code = gray_code(np.arange(shape[axis] + 1), max(1, gray_bits(shape[axis])))
    told = []
    # where a pixel sees an edge of the finest stripes, the same moved by one have none
    for fine in (code[-1, :-1], code[-1, 1:]):
        lines = np.stack([fine, *(code[:, :-1] ^ fine)])
        along = np.expand_dims(lines, 2 - axis)
        images = _relit(transport, np.broadcast_to(along, (len(lines), *shape)).astype(np.float32))
        above = images - floodlit / 2
        lit = (above[1:] > 0) ^ (above[0] > 0)
        told.append((np.abs(above[0]), gray_number(lit)))
    (clear, first), (clearer, second) = told
    found: NDArray[np.int64] = np.where(clearer > clear, second, first)
    return np.minimum(found, shape[axis] - 1)


def _around(transport: MatrixAlgebra, coarse: list[NDArray[np.int64]]) -> Float:
    """Return each pixel's entries around its place, (rows, columns, camera rays)."""
    shape = transport.projector_shape[-2:]
    row, column = np.indices(shape)
    entries = np.empty((_APART, _APART, len(coarse[0])), np.float32)
    # which of the window's places a dot at each offset is near
    shift = np.arange(_APART)[:, None] - (coarse[0] - _APART // 2)
    across = np.arange(_APART)[:, None] - (coarse[1] - _APART // 2)
    pixel = np.arange(len(coarse[0]))
    for first in range(_APART):
        lit = (row % _APART == first) & (column % _APART == np.arange(_APART)[:, None, None])
        images = _relit(transport, lit.astype(np.float32))
        for second, image in enumerate(images):
            entries[shift[first] % _APART, across[second] % _APART, pixel] = image
    return entries
