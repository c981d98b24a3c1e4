"""Light that mirrors and lenses throw, followed from the projector.

A path from the camera can't find it, since it meets a projector, a point, by chance only. So paths
start at the projector's pixels too. Those that a mirror or a lens bends first are connected with
the camera at each surface that scatters light, and merged with what the camera sees there by
mirrors and lenses of its own. Each path of light is found in one way: from the camera, if its last
surface before the projector scatters; else by connection, if its first surface before the camera
does; else by merging, where the camera's chain ends. What fills bodies plays no part.

No path connects a projector and a camera that both look through a lens. But where light from the
projector comes to a surface near the end of a camera's chain, the two are taken to meet: light
within a radius ``r`` of an end is that of a disc ``pi r^2`` about it (photon mapping: Jensen 1996;
the merging of vertices of Georgiev et al. 2012). So pictures are blurred by such discs, as wide as
a pixel's footprint at the end: by a pixel. A radius that was half as long would move as much
energy, half as far, but where a lens gathers light that is seen through it: that grows without
bound.
"""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe.mitsuba.beams import Rig, Sums, begin, is_bent, is_unbent, survival
from rfpipe.mitsuba.world import MERGING_RADIUS

Single = NDArray[np.float32]
Double = NDArray[np.float64]

_MOST_UNBENT = 16  # boundaries that a chain passes straight on
_FEW = 8  # chains that are too few to tell a footprint
# A footprint, relative to that of light that isn't bent. Where a lens gathers light in a point
# that pinholes see through it, radiance has no bound but that of a finite disc.
_FOOTPRINTS = (1.0, 4.0)
_FLAT = 0.25  # how far off a disc's plane a surface may be, relative to its radius
_SAME_SIDE = 0.7  # least cosine between normals of the one surface
_PRIMES = (73856093, 19349663, 83492791, 2654435761)  # Teschner et al. 2003, and Knuth's
_MOST_BUCKETS = 2**22
_LEAST_COSINE = 1e-4


class ChainEnds(NamedTuple):
    """Surfaces that the camera sees by mirrors and lenses: where its chains of bounces end.

    Attributes
    ----------
    place, normal, way : ndarray, float32 (n, 3)
        Where they are, in scene units, the surface's normal, and the direction that light goes on
        to the camera in.
    weight : ndarray, float32 (n, 3)
        What share of the radiance there adds to the pixel's.
    pixel : ndarray, uint32 (n,)
        In the ray domain of all cameras.
    bounces : ndarray, uint32 (n,)
        Mirrors and lenses met on the way, at least 1.
    footprint : ndarray, float32 (n,)
        How wide the pixel is there, in scene units: the narrower side of what its chains by the
        same mirrors and lenses reach, but no less than without them.
    """

    place: Single
    normal: Single
    way: Single
    weight: Single
    pixel: NDArray[np.uint32]
    bounces: NDArray[np.uint32]
    footprint: Single


def trace_chains(rig: Rig, samples: int, seed: int) -> ChainEnds:
    """Trace chains, `samples` (a power of 4) from each camera pixel.

    A chain goes on as long as mirrors and lenses alone turn it; what it meets that scatters light
    is an end of it. It leaves at least one vertex to light on its way from the projector.
    """
    side = rig.camera.side
    pixel, ray, sampler = begin(rig.camera, 0, side.rays, samples, seed)
    context = mi.BSDFContext()
    weight, bent, length = mi.Color3f(1 / samples), mi.UInt32(0), mi.Float(0)
    track: Any = mi.UInt32(0)
    active: Any = mi.Bool(True)
    reached = []
    for _ in range(rig.bounces + _MOST_UNBENT):
        si = rig.scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)
        length += dr.select(active, si.t, 0)
        track = track * 31 + mi.UInt32(dr.reinterpret_array(mi.UInt32, si.shape))
        ends = active & (bent > 0) & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        at: Any = dr.compress(ends)
        state = (si.p, si.n, -ray.d, weight, pixel, bent, length * side.pitch, track)
        reached.append([np.moveaxis(dr.gather(type(x), x, at).numpy(), -1, 0) for x in state])

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        turned = is_bent(sample)
        weight, bent = weight * value, dr.select(turned, bent + 1, bent)
        track = track * 31 + sample.sampled_type
        active &= (turned | is_unbent(sample)) & dr.any(weight > 0) & (bent + 2 <= rig.bounces)
        ray = si.spawn_ray(si.to_world(sample.wo))
        dr.eval(ray, weight, bent, length, track, active, sampler)
        if not dr.any(active):
            break
    place, normal, way, share, pixels, bends, unbent, tracks = (
        np.concatenate(parts) for parts in zip(*reached, strict=True)
    )
    footprint = _footprints(place, pixels, tracks, unbent)
    return ChainEnds(place, normal, way, share, pixels, bends, footprint)


def _footprints(
    place: Single, pixel: NDArray[np.uint32], track: NDArray[np.uint32], unbent: Single
) -> Single:
    """Return the narrower side of what each pixel's chains of one track reach.

    A parallelogram's points, evenly spread, have a variance of a twelfth of a side's square.
    """
    groups = pixel.astype(np.uint64) << np.uint64(32) | track
    _, group, count = np.unique(groups, return_inverse=True, return_counts=True)

    def mean(values: Double) -> Double:
        return np.stack([np.bincount(group, row, len(count)) / count for row in values.T], axis=1)

    centred = place - mean(place.astype(np.float64))[group]
    products = (centred[:, :, None] * centred[:, None, :]).reshape(-1, 9)
    spreads = np.linalg.eigvalsh(mean(products).reshape(-1, 3, 3))[:, 1]
    sides = np.sqrt(12 * np.maximum(spreads, 0))[group]
    sides = np.where(count[group] < _FEW, unbent, sides)
    narrowest, widest = _FOOTPRINTS
    return np.clip(sides, narrowest * unbent, widest * unbent).astype(np.float32)


class Near(NamedTuple):
    """Ends that places are near to: whether there is one, and what `ChainEnds` says of it.

    The weight is that of the chain, over the disc's area and the probability of the pick.
    """

    is_one: Any
    pixel: Any
    bounces: Any
    way: Any
    weight: Any


class Ends:
    """Ends of the camera's chains, at least one, to be looked up by place.

    They lie in `levels` grids, one for each octave of their radii. Each is listed in all the cells
    that its disc meets, so that a place looks up one cell of each grid, and picks one end there.
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
        weight = ends.weight / (np.pi * radius[:, None] ** 2)
        self._place, self._normal, self._way, self._weight = (
            mi.Float(np.ascontiguousarray(array, dtype=np.float32).ravel())
            for array in (ends.place, ends.normal, ends.way, weight)
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
        is_one = active & (count > 0)
        pick = start + dr.minimum(mi.UInt32(sample * count), count - 1)
        end = dr.gather(mi.UInt32, self._listed, pick, is_one)

        def vector(values: Any) -> Any:
            return mi.Vector3f(
                *(dr.gather(mi.Float, values, end * 3 + k, is_one) for k in range(3))
            )

        off, normal = si.p - vector(self._place), vector(self._normal)
        radius = dr.gather(mi.Float, self._radius, end, is_one)
        is_one &= dr.squared_norm(off) < radius * radius
        is_one &= dr.abs(dr.dot(off, normal)) < _FLAT * radius
        is_one &= dr.dot(si.n, normal) > _SAME_SIDE
        return Near(
            is_one,
            dr.gather(mi.UInt32, self._pixel, end, is_one),
            dr.gather(mi.UInt32, self._bounces, end, is_one),
            vector(self._way),
            mi.Color3f(vector(self._weight) * mi.Float(count)),
        )


def _listed(
    ends: ChainEnds, radius: Single, level: NDArray[np.int64], width: Double
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
        parts = [*cell[where].T, level[where]]
        words = [
            part.astype(np.int64).astype(np.uint32) * np.uint32(prime)
            for part, prime in zip(parts, _PRIMES, strict=True)
        ]
        hashes.append(np.bitwise_xor.reduce(words))
        indices.append(where.astype(np.uint32))
    return np.concatenate(hashes), np.concatenate(indices)


def trace_particles(rig: Rig, sums: Sums, samples: int, seed: int, *, ends: Ends | None) -> None:
    """Trace `samples` paths from each projector pixel of `sums`; add what they throw to its column.

    `ends` are those of the camera's chains, to be merged with.
    """
    column, ray, sampler = begin(rig.projector, sums.first, sums.count, samples, seed)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    # A pixel sends what falls on its square of the image plane, and takes the mean over its own.
    sent = rig.projector.side.pitch**2
    per_pixel = sent / rig.camera.side.pitch**2 * rig.camera.count

    def merge(
        ends: Ends, si: Any, bsdf: Any, weight: Any, done: Any, active: Any, sampler: Any
    ) -> Any:
        def at_level(level: Any, sampler: Any) -> tuple[Any, ...]:
            near = ends.near(si, level, sampler.next_1d(active), active)
            meets = near.is_one & (done + near.bounces < rig.bounces)
            to_camera = si.to_local(near.way)
            # What a disc gets doesn't depend on the slant that it is seen at.
            slant = dr.maximum(dr.abs(to_camera.z), _LEAST_COSINE)
            seen = bsdf.eval(context, si, to_camera, meets) / slant
            sums.add(column, near.pixel, weight * seen * near.weight * sent, meets)
            return level + 1, sampler

        return dr.while_loop(
            (mi.UInt32(0), sampler),
            lambda level, _sampler: active & (level < ends.levels),
            at_level,
        )[1]

    def bounce(
        ray: Any, weight: Any, done: Any, bent: Any, active: Any, sampler: Any
    ) -> tuple[Any, ...]:
        si = rig.scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        look = rig.camera.look(sampler.next_1d(), si.p)
        to_camera = si.to_local(dr.normalize(look.origin - si.p))
        scatters = active & bent & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        seen = scatters & look.seen
        light = weight * bsdf.eval(context, si, to_camera, seen) * (look.flux * per_pixel)
        seen &= dr.any(light > 0)
        seen &= ~rig.scene.ray_test(si.spawn_ray_to(look.origin), seen)
        sums.add(column, look.pixel, light, seen)
        if ends is not None:
            sampler = merge(ends, si, bsdf, weight, done, scatters, sampler)

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        unbent = is_unbent(sample)
        weight, done = weight * value, dr.select(unbent, done, done + 1)
        # Light whose first surface isn't bent by it is found from the camera.
        bent |= is_bent(sample) & (done == 1)
        goes_on = dr.select(unbent, mi.Float(1), survival(weight, done))
        active &= (bent | (done == 0)) & dr.any(weight > 0) & (done < rig.bounces)
        active &= sampler.next_1d() < goes_on
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / goes_on, done, bent, active, sampler

    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(False), mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )
