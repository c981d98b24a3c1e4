"""Light from the projector merged with what the camera sees by mirrors and lenses (photon mapping).

No path connects a projector and a camera that both look through a lens. But where light from the
projector comes to a surface near the end of a camera's chain, the two are taken to meet: light
within a radius ``r`` of an end is that of a disc ``pi r^2`` about it (Jensen 1996; the merging of
vertices of Georgiev et al. 2012). So pictures are blurred by such discs, as wide as a pixel's
footprint at the end: by a pixel. A radius that was half as long would move as much energy, half as
far, but where a lens gathers light that is seen through it: that grows without bound.

Ends lie in grids, one for each octave of their radii. Each is listed in all the cells that its disc
meets, so that a place looks up one cell of each grid, and picks one end there by chance.
"""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe_mitsuba.chains import ChainEnds
from rfpipe_mitsuba.light import MERGING_RADIUS

__all__ = ["Ends", "Near"]

Double = NDArray[np.float64]

_FLAT = 0.25  # how far off the disc's plane a surface may be, relative to its radius
_SAME_SIDE = 0.7  # least cosine between normals of the one surface
_PRIMES = (73856093, 19349663, 83492791, 2654435761)  # Teschner et al. 2003, and Knuth's
_MOST_BUCKETS = 2**22


class Near(NamedTuple):
    """Ends that places are near to.

    Attributes
    ----------
    found : Bool
        Whether there is one.
    pixel, bounces : UInt32
        As of `ChainEnds`.
    way : Vector3f
        As of `ChainEnds`.
    weight : Color3f
        That of the chain, over the disc's area, and over the probability of the pick.
    """

    found: Any
    pixel: Any
    bounces: Any
    way: Any
    weight: Any


class Ends:
    """Ends of the camera's chains, to be looked up by place.

    Parameters
    ----------
    ends
        At least one.

    Attributes
    ----------
    levels : int
        Number of grids.
    """

    def __init__(self, ends: ChainEnds) -> None:
        radius = ends.footprint * np.float32(MERGING_RADIUS)
        octave = np.floor(np.log2(radius)).astype(np.int64) + 1  # cells are wider than a radius
        level = octave.max() - octave
        self.levels = int(level.max()) + 1
        buckets, listed = _listed(ends, radius, level, np.exp2(octave))
        count = min(_MOST_BUCKETS, 1 << len(listed).bit_length())
        entries = np.unique(
            (buckets & np.uint32(count - 1)).astype(np.uint64) << np.uint64(32) | listed
        )
        starts = np.searchsorted(entries, np.arange(count + 1, dtype=np.uint64) << np.uint64(32))
        self._mask = count - 1
        self._scales = mi.Float(np.exp2(np.arange(self.levels) - octave.max()).astype(np.float32))
        self._starts = mi.UInt32(starts.astype(np.uint32))
        self._listed = mi.UInt32((entries & np.uint64(2**32 - 1)).astype(np.uint32))
        self._place, self._normal, self._way, self._weight = (
            mi.Float(np.ascontiguousarray(each, dtype=np.float32).ravel())
            for each in (
                ends.place,
                ends.normal,
                ends.way,
                ends.weight / (np.pi * radius[:, None] ** 2),
            )
        )
        self._radius, self._pixel = mi.Float(radius), mi.UInt32(ends.pixel)
        self._bounces = mi.UInt32(ends.bounces)

    def near(self, si: Any, level: Any, sample: Any, active: Any) -> Near:
        """Pick an end near surface interactions in the grid of a level, by a random number."""
        # Cells are as wide as a power of two, so that rounding puts no place into another one.
        place = si.p * dr.gather(mi.Float, self._scales, level, active)
        cell = mi.Vector3i(dr.floor(place))
        bucket = level * _PRIMES[3]
        for index in range(3):
            bucket ^= mi.UInt32(cell[index]) * _PRIMES[index]
        bucket &= self._mask
        start = dr.gather(mi.UInt32, self._starts, bucket, active)
        count = dr.gather(mi.UInt32, self._starts, bucket + 1, active) - start
        found = active & (count > 0)
        pick = start + dr.minimum(mi.UInt32(sample * count), count - 1)
        end = dr.gather(mi.UInt32, self._listed, pick, found)

        def vector(values: Any) -> Any:
            return mi.Vector3f(*(dr.gather(mi.Float, values, end * 3 + k, found) for k in range(3)))

        off, normal = si.p - vector(self._place), vector(self._normal)
        radius = dr.gather(mi.Float, self._radius, end, found)
        found &= dr.squared_norm(off) < radius * radius
        found &= dr.abs(dr.dot(off, normal)) < _FLAT * radius
        found &= dr.dot(si.n, normal) > _SAME_SIDE
        return Near(
            found,
            dr.gather(mi.UInt32, self._pixel, end, found),
            dr.gather(mi.UInt32, self._bounces, end, found),
            vector(self._way),
            mi.Color3f(vector(self._weight) * mi.Float(count)),
        )


def _listed(
    ends: ChainEnds, radius: NDArray[np.float32], level: NDArray[np.int64], width: Double
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return hashes of the cells that the disc of an end meets, and the end, of all ends."""
    place = ends.place.astype(np.float64)
    lowest = np.floor((place - radius[:, None]) / width[:, None])
    slant = np.abs(ends.normal).sum(axis=1) * width / 2
    hashes, indices = [], []
    for step in product(range(3), repeat=3):
        cell = lowest + step
        middle = (cell + 0.5) * width[:, None] - place
        off = np.maximum(np.abs(middle) - width[:, None] / 2, 0)
        meets = (off**2).sum(axis=1) < radius**2
        meets &= np.abs((middle * ends.normal).sum(axis=1)) < slant + _FLAT * radius
        where = np.flatnonzero(meets)
        parts = [cell[where, 0], cell[where, 1], cell[where, 2], level[where]]
        words = [
            part.astype(np.int64).astype(np.uint32) * np.uint32(prime)
            for part, prime in zip(parts, _PRIMES, strict=True)
        ]
        hashes.append(np.bitwise_xor.reduce(words))
        indices.append(where.astype(np.uint32))
    return np.concatenate(hashes), np.concatenate(indices)
