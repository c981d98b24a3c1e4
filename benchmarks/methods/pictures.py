"""Pictures that are relit beside those of the report: small spots, and edges where surfaces meet.

A change of this file makes the whole benchmark anew, since its text is part of what rows are known
by.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes import CREASE

if TYPE_CHECKING:
    from rfpipe_mitsuba.scene import MitsubaScene

__all__ = ["crease", "spots"]

Float = NDArray[np.float32]

_SPOTS = {"spot_right": (2 / 3, 3 / 4), "spot_low": (5 / 6, 1 / 2)}  # where, of height and width
_SPOT = 2  # pixels along either side
_MEETING = 4.0  # distance of neighbouring points that meet, over the side of a pixel there
_FACING = 0.1  # sum of the sines by which two neighbours stand above each other's planes, at least
_BENT = 0.87  # cosine of the angle between their normals, at most: 30 degrees


def spots(shape: tuple[int, ...]) -> dict[str, Float]:
    """Small spots, in each view of a stack."""
    spots = {}
    for name, (down, across) in _SPOTS.items():
        spots[name] = np.zeros(shape, np.float32)
        top, left = int(down * shape[-2]), int(across * shape[-1])
        spots[name][..., top : top + _SPOT, left : left + _SPOT] = 1
    return spots


def crease(scene: MitsubaScene) -> dict[str, Float]:
    """Return the projector's pixels along concave edges, where surfaces meet; none, no picture.

    The rays through the pixels' centres meet surfaces whose normals differ, which face each other,
    and which are as near as neighbours on one surface are.
    """
    points, normals, size = _hits(scene)
    strip = np.zeros(points.shape[:-1], np.bool_)
    for axis in (1, 2):
        last = points.shape[axis]
        one, other = (
            [np.take(each, range(*span), axis) for each in (points, normals, size)]
            for span in ((0, last - 1), (1, last))
        )
        apart = other[0] - one[0]
        distance = np.linalg.norm(apart, axis=-1)
        with np.errstate(invalid="ignore"):
            meet = distance <= _MEETING * (one[2] + other[2]) / 2
            towards = _dot(apart, one[1]), -_dot(apart, other[1])
            facing = sum(towards) > _FACING * distance
            facing &= np.minimum(*towards) > -_FACING / 10 * distance  # one may lie on the edge
            meet &= facing & (_dot(one[1], other[1]) < _BENT)
        before, after = [(0, 0)] * 3, [(0, 0)] * 3
        before[axis], after[axis] = (1, 0), (0, 1)
        strip |= np.pad(meet, before) | np.pad(meet, after)
    return {CREASE: strip.reshape(scene.projector_shape).astype(np.float32)} if strip.any() else {}


def _dot(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    return np.einsum("...a,...a->...", one, other)


def _hits(scene: MitsubaScene) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Points (V, H, W, 3), normals towards the projector, and a pixel's side there (V, H, W)."""
    from rfpipe_mitsuba.rendering import hits
    from rfpipe_mitsuba.world import load_scene

    shapes = load_scene(scene.world)
    side = scene.projector
    found = []
    for pinhole in side.pinholes:
        ways = pinhole.rays()
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        lengths, normals = hits(shapes, pinhole)
        cosines = _dot(ways, normals)
        normals *= -np.sign(cosines)[:, None]
        lengths[~np.isfinite(lengths)] = np.nan
        pitch = side.pitch * lengths / np.sqrt(np.maximum(np.abs(cosines), 1e-3))
        found.append((pinhole.origin + lengths[:, None] * ways, normals, pitch))
    points, turned, sizes = (np.stack(each) for each in zip(*found, strict=True))
    shape = (len(side.pinholes), *side.shape)
    return points.reshape(*shape, 3), turned.reshape(*shape, 3), sizes.reshape(shape)
