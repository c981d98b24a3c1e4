"""Caustics: light that mirrors and lenses throw on surfaces, traced from the projector.

A path from the camera meets the projector, a point, only by chance, so paths also start at the
projector's pixels. Those that a mirror or a lens deflects first are connected with the camera at
each diffuse surface, and merged there with chains of specular bounces from the camera. Each path of
light is counted once: from the camera, if its last surface before the projector is diffuse; else by
connection, if its first surface before the camera is diffuse; else by merging, where the camera's
chain ends. Media within bodies are ignored.

No path connects a projector and a camera that both look through a lens. But where light from the
projector reaches a surface near the end of a camera's chain, the two are merged: light within a
radius ``r`` of an end is spread over a disc of area ``pi r^2`` (photon mapping: Jensen 1996; vertex
merging: Georgiev et al. 2012). This blurs pictures by about one pixel, as discs are as wide as a
pixel's footprint at the end. Halving the radius would displace the same energy half as far, except
where a lens focuses light that is seen through it: its radiance then grows without bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float
from rfpipe.mitsuba.beams import Sums, TracedScene, begin, is_specular, passes_straight, survival
from rfpipe.mitsuba.world import MERGING_RADIUS

_MAX_BOUNDARIES = 16  # boundaries that a chain passes without refraction
_MIN_CHAINS_OF_FOOTPRINT = 8  # to estimate a footprint from their spread
# Bounds of a footprint, relative to that without deflection. Where a lens focuses light on a point
# that pinholes see through it, only a finite disc bounds the radiance.
_FOOTPRINTS = (1.0, 4.0)
_MAX_ELEVATION = 0.25  # of a surface above a disc's plane, relative to the disc's radius
_MIN_NORMAL_COSINE = 0.7  # between normals of the same surface
_PRIMES = (73856093, 19349663, 83492791, 2654435761)  # Teschner et al. 2003; the last is Knuth's
_MAX_BUCKETS = 2**22
_MIN_COSINE = 1e-4


class ChainEnds(NamedTuple):
    """Diffuse surface points that the camera sees by specular chains: the ends of these chains.

    Attributes
    ----------
    position, normal, direction : ndarray, float32 (n, 3)
        Position in scene units, surface normal, and direction of light towards the camera.
    weight : ndarray, float32 (n, 3)
        Contribution of the radiance there to the pixel's radiance.
    pixel : ndarray, uint32 (n,)
        Pixel in the ray domain of all cameras.
    bounces : ndarray, uint32 (n,)
        Specular bounces of the chain, at least 1.
    footprint : ndarray, float32 (n,)
        Width of the pixel there, in scene units: the shorter side of the area that its chains by
        the same mirrors and lenses reach, but at least the width without deflection.
    """

    position: Float
    normal: Float
    direction: Float
    weight: Float
    pixel: NDArray[np.uint32]
    bounces: NDArray[np.uint32]
    footprint: Float


def trace_chains(rig: TracedScene, samples: int, seed: int) -> ChainEnds:
    """Trace `samples` (a power of 4) specular chains from each camera pixel.

    A chain continues through mirrors and lenses only; each diffuse surface that it meets is an end.
    It leaves at least one bounce to the path from the projector.
    """
    side = rig.camera.side
    pixel, ray, sampler = begin(rig.camera, 0, side.rays, samples, seed)
    context = mi.BSDFContext()
    weight, deflections, length = mi.Color3f(1 / samples), mi.UInt32(0), mi.Float(0)
    track: Any = mi.UInt32(0)
    active: Any = mi.Bool(True)
    ends = []
    for _ in range(rig.bounces + _MAX_BOUNDARIES):
        si = rig.scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)
        length += dr.select(active, si.t, 0)
        track = track * 31 + mi.UInt32(dr.reinterpret_array(mi.UInt32, si.shape))
        is_end = active & (deflections > 0) & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        index: Any = dr.compress(is_end)
        state = (si.p, si.n, -ray.d, weight, pixel, deflections, length * side.pitch, track)
        ends.append([np.moveaxis(dr.gather(type(x), x, index).numpy(), -1, 0) for x in state])

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        specular = is_specular(sample)
        weight = weight * value
        deflections = dr.select(specular, deflections + 1, deflections)
        track = track * 31 + sample.sampled_type
        active &= specular | passes_straight(sample)
        active &= dr.any(weight > 0) & (deflections + 2 <= rig.bounces)
        ray = si.spawn_ray(si.to_world(sample.wo))
        dr.eval(ray, weight, deflections, length, track, active, sampler)
        if not dr.any(active):
            break
    position, normal, direction, contribution, pixels, bounces, undeflected, tracks = (
        np.concatenate(parts) for parts in zip(*ends, strict=True)
    )
    footprint = _footprints(position, pixels, tracks, undeflected)
    return ChainEnds(position, normal, direction, contribution, pixels, bounces, footprint)


def _footprints(
    position: Float, pixel: NDArray[np.uint32], track: NDArray[np.uint32], undeflected: Float
) -> Float:
    """Shorter side of the area that each pixel's chains by the same surfaces (track) reach.

    Points spread evenly over a parallelogram have a variance of ``side^2 / 12``.
    """
    groups = pixel.astype(np.uint64) << np.uint64(32) | track
    _, group, count = np.unique(groups, return_inverse=True, return_counts=True)

    def mean(values: Double) -> Double:
        return np.stack([np.bincount(group, row, len(count)) / count for row in values.T], axis=1)

    centred = position - mean(position.astype(np.float64))[group]
    products = (centred[:, :, None] * centred[:, None, :]).reshape(-1, 9)
    spreads = np.linalg.eigvalsh(mean(products).reshape(-1, 3, 3))[:, 1]
    sides = np.sqrt(12 * np.maximum(spreads, 0))[group]
    sides = np.where(count[group] < _MIN_CHAINS_OF_FOOTPRINT, undeflected, sides)
    narrowest, widest = _FOOTPRINTS
    return np.clip(sides, narrowest * undeflected, widest * undeflected).astype(np.float32)


class Near(NamedTuple):
    """Chain ends near surface points; attributes as in `ChainEnds`, where `exists`.

    The weight is divided by the disc's area and by the probability of selecting the end.
    """

    exists: Any
    pixel: Any
    bounces: Any
    direction: Any
    weight: Any


class Ends:
    """Spatial index of the ends of the camera's chains, at least one.

    There are `levels` hashed grids, one for each octave of radii. Each end is listed in all cells
    that its disc intersects, so a lookup selects one end in a single cell of each grid.
    """

    def __init__(self, ends: ChainEnds) -> None:
        radius = ends.footprint * np.float32(MERGING_RADIUS)
        octave = np.floor(np.log2(radius)).astype(np.int64) + 1  # cells are wider than a radius
        level = octave.max() - octave
        self.levels = int(level.max()) + 1
        buckets, indices = _cells(ends, radius, level, np.exp2(octave))
        count = min(_MAX_BUCKETS, 1 << len(indices).bit_length())
        entries = np.unique(
            (buckets & np.uint32(count - 1)).astype(np.uint64) << np.uint64(32) | indices
        )
        starts = np.searchsorted(entries, np.arange(count + 1, dtype=np.uint64) << np.uint64(32))
        self._mask = count - 1
        self._scales = mi.Float(np.exp2(np.arange(self.levels) - octave.max()).astype(np.float32))
        self._starts = mi.UInt32(starts.astype(np.uint32))
        self._indices = mi.UInt32((entries & np.uint64(2**32 - 1)).astype(np.uint32))
        weight = ends.weight / (np.pi * radius[:, None] ** 2)
        self._position, self._normal, self._direction, self._weight = (
            mi.Float(np.ascontiguousarray(array, dtype=np.float32).ravel())
            for array in (ends.position, ends.normal, ends.direction, weight)
        )
        self._radius, self._pixel = mi.Float(radius), mi.UInt32(ends.pixel)
        self._bounces = mi.UInt32(ends.bounces)

    def near(self, si: Any, level: Any, sample: Any, active: Any) -> Near:
        """Select an end near surface points in the grid of a level, by a random number."""
        # Widths of cells are powers of two, so rounding doesn't change the cell.
        scaled = si.p * dr.gather(mi.Float, self._scales, level, active)
        cell = mi.Vector3i(dr.floor(scaled))
        bucket = level * _PRIMES[3]
        for index in range(3):
            bucket ^= mi.UInt32(cell[index]) * _PRIMES[index]
        bucket &= self._mask
        start = dr.gather(mi.UInt32, self._starts, bucket, active)
        count = dr.gather(mi.UInt32, self._starts, bucket + 1, active) - start
        exists = active & (count > 0)
        selected = start + dr.minimum(mi.UInt32(sample * count), count - 1)
        end = dr.gather(mi.UInt32, self._indices, selected, exists)

        def vector(values: Any) -> Any:
            return mi.Vector3f(
                *(dr.gather(mi.Float, values, end * 3 + k, exists) for k in range(3))
            )

        offset, normal = si.p - vector(self._position), vector(self._normal)
        radius = dr.gather(mi.Float, self._radius, end, exists)
        exists &= dr.squared_norm(offset) < radius * radius
        exists &= dr.abs(dr.dot(offset, normal)) < _MAX_ELEVATION * radius
        exists &= dr.dot(si.n, normal) > _MIN_NORMAL_COSINE
        return Near(
            exists,
            dr.gather(mi.UInt32, self._pixel, end, exists),
            dr.gather(mi.UInt32, self._bounces, end, exists),
            vector(self._direction),
            mi.Color3f(vector(self._weight) * mi.Float(count)),
        )


def _cells(
    ends: ChainEnds, radius: Float, level: NDArray[np.int64], width: Double
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the hash of each cell that an end's disc intersects, and the index of the end."""
    position = ends.position.astype(np.float64)
    lowest = np.floor((position - radius[:, None]) / width[:, None])
    slant = np.abs(ends.normal).sum(axis=1) * width / 2
    hashes, indices = [], []
    for step in product(range(3), repeat=3):
        cell = lowest + step
        middle = (cell + 0.5) * width[:, None] - position
        outside = np.maximum(np.abs(middle) - width[:, None] / 2, 0)
        intersects = (outside**2).sum(axis=1) < radius**2
        distance = np.abs((middle * ends.normal).sum(axis=1))
        intersects &= distance < slant + _MAX_ELEVATION * radius
        hit = np.flatnonzero(intersects)
        parts = [*cell[hit].T, level[hit]]
        words = [
            part.astype(np.int64).astype(np.uint32) * np.uint32(prime)
            for part, prime in zip(parts, _PRIMES, strict=True)
        ]
        hashes.append(np.bitwise_xor.reduce(words))
        indices.append(hit.astype(np.uint32))
    return np.concatenate(hashes), np.concatenate(indices)


def trace_particles(
    rig: TracedScene, sums: Sums, samples: int, seed: int, *, ends: Ends | None
) -> None:
    """Trace `samples` paths from each projector pixel of `sums`; add caustics to its column.

    Paths are merged with `ends` of the camera's chains, if there are any.
    """
    column, ray, sampler = begin(rig.projector, sums.first, sums.count, samples, seed)
    tracer = _ParticleTracer(rig, sums, column, ends)
    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(False), mi.Bool(True), sampler),
        lambda *state: state[-2],
        tracer.bounce,
    )


class _Vertex(NamedTuple):
    """Vertices of paths from the projector: surface, BSDF, throughput, and bounces before them."""

    si: Any
    bsdf: Any
    weight: Any
    bounces: Any


@dataclass(frozen=True)
class _ParticleTracer:
    """Bounces of paths from the projector, and their connections with the camera."""

    rig: TracedScene
    sums: Sums
    column: Any
    ends: Ends | None

    @property
    def _pixel_flux(self) -> float:
        """Light through a projector pixel: its area of the image plane at distance 1."""
        return self.rig.projector.side.pitch**2

    def bounce(
        self, ray: Any, weight: Any, bounces: Any, deflected: Any, active: Any, sampler: Any
    ) -> tuple[Any, ...]:
        """Extend paths by one bounce, and add their light to the sums."""
        si = self.rig.scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        vertex = _Vertex(si, si.bsdf(ray), weight, bounces)
        diffuse = active & deflected & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Smooth)
        self._connect(vertex, diffuse, sampler)
        if self.ends is not None:
            sampler = self._merge(self.ends, vertex, diffuse, sampler)

        context = mi.BSDFContext(mi.TransportMode.Importance)
        sample, value = vertex.bsdf.sample(
            context, si, sampler.next_1d(), sampler.next_2d(), active
        )
        straight = passes_straight(sample)
        weight, bounces = weight * value, dr.select(straight, bounces, bounces + 1)
        # Paths whose first surface is diffuse are traced from the camera.
        deflected |= is_specular(sample) & (bounces == 1)
        probability = dr.select(straight, mi.Float(1), survival(weight, bounces))
        active &= (deflected | (bounces == 0)) & dr.any(weight > 0) & (bounces < self.rig.bounces)
        active &= sampler.next_1d() < probability
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / probability, bounces, deflected, active, sampler

    def _connect(self, vertex: _Vertex, diffuse: Any, sampler: Any) -> None:
        """Add light that reaches the camera directly from diffuse vertices."""
        si, camera = vertex.si, self.rig.camera
        view = camera.project(si.p, sampler)
        to_camera = si.to_local(dr.normalize(view.origin - si.p))
        visible = diffuse & view.inside
        context = mi.BSDFContext(mi.TransportMode.Importance)
        # A camera pixel measures the mean over its area.
        per_pixel = self._pixel_flux / camera.side.pitch**2 * camera.count
        light = vertex.weight * vertex.bsdf.eval(context, si, to_camera, visible)
        light *= view.flux * per_pixel
        visible &= dr.any(light > 0)
        visible &= ~self.rig.scene.ray_test(si.spawn_ray_to(view.origin), visible)
        self.sums.add(self.column, view.pixel, light, visible)

    def _merge(self, ends: Ends, vertex: _Vertex, diffuse: Any, sampler: Any) -> Any:
        """Add light that reaches the camera by specular chains that end near diffuse vertices."""
        si, context = vertex.si, mi.BSDFContext(mi.TransportMode.Importance)

        def merge_level(level: Any, sampler: Any) -> tuple[Any, ...]:
            near = ends.near(si, level, sampler.next_1d(diffuse), diffuse)
            merged = near.exists & (vertex.bounces + near.bounces < self.rig.bounces)
            to_camera = si.to_local(near.direction)
            # The flux on a disc doesn't depend on the angle to the camera.
            cosine = dr.maximum(dr.abs(to_camera.z), _MIN_COSINE)
            reflected = vertex.bsdf.eval(context, si, to_camera, merged) / cosine
            light = vertex.weight * reflected * near.weight * self._pixel_flux
            self.sums.add(self.column, near.pixel, light, merged)
            return level + 1, sampler

        return dr.while_loop(
            (mi.UInt32(0), sampler),
            lambda level, _sampler: diffuse & (level < ends.levels),
            merge_level,
        )[1]
