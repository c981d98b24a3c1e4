"""Surfaces that the camera sees by mirrors and lenses: where its chains of bounces end.

A chain starts at a camera pixel and goes on as long as mirrors and lenses alone turn it. What it
meets that scatters light is an end of it, which light from the projector can be merged with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe_mitsuba.paths import begin, is_bent, is_unbent
from rfpipe_mitsuba.pinholes import Pinholes

__all__ = ["ChainEnds", "trace_chains"]

Single = NDArray[np.float32]
Double = NDArray[np.float64]

_MOST_UNBENT = 16  # boundaries that a chain passes straight on
_FEW = 8  # chains that are too few to tell a footprint
# Bounds of a footprint, relative to that of light that isn't bent. Where a lens gathers light in a
# point that pinholes see through it, radiance has no bound but that of a finite disc.
_LEAST, _MOST = 1.0, 4.0


@dataclass(frozen=True)
class ChainEnds:
    """Ends of chains, n of them.

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


def trace_chains(
    scene: Any, camera: Pinholes, *, samples: int, bounces: int, seed: int
) -> ChainEnds:
    """Trace chains from each camera pixel.

    Parameters
    ----------
    scene
        Mitsuba's scene of surfaces.
    samples
        Chains a pixel, a power of 4.
    bounces
        Most vertices of a path between projector and camera, of which a chain leaves at least one
        to light on its way from the projector.
    seed
        Of the random numbers.
    """
    pixel, ray, sampler = begin(camera, 0, camera.views.rays, samples, seed)
    context = mi.BSDFContext()
    weight, bent, length = mi.Color3f(1 / samples), mi.UInt32(0), mi.Float(0)
    track: Any = mi.UInt32(0)
    active: Any = mi.Bool(True)
    found = []
    for _ in range(bounces + _MOST_UNBENT):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)
        length += dr.select(active, si.t, 0)
        track = track * 31 + mi.UInt32(dr.reinterpret_array(mi.UInt32, si.shape))
        ends = active & (bent > 0) & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        at = dr.compress(ends)
        state = (si.p, si.n, -ray.d, weight, pixel, bent, length * camera.views.pitch, track)
        found.append([_to_numpy(each, at) for each in state])

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        turned = is_bent(sample)
        weight, bent = weight * value, dr.select(turned, bent + 1, bent)
        track = track * 31 + sample.sampled_type
        active &= (turned | is_unbent(sample)) & dr.any(weight > 0) & (bent + 2 <= bounces)
        ray = si.spawn_ray(si.to_world(sample.wo))
        dr.eval(ray, weight, bent, length, track, active, sampler)
        if not dr.any(active):
            break
    place, normal, way, share, pixels, bends, unbent, tracks = (
        np.concatenate(each) for each in zip(*found, strict=True)
    )
    footprint = _footprints(place, pixels, tracks, unbent)
    return ChainEnds(place, normal, way, share, pixels, bends, footprint)


def _to_numpy(values: Any, at: Any) -> NDArray[Any]:
    """Return some of an array's lanes: (n,), or (n, 3) of vectors."""
    return np.moveaxis(dr.gather(type(values), values, at).numpy(), -1, 0)


def _footprints(
    place: Single, pixel: NDArray[np.uint32], track: NDArray[np.uint32], unbent: Single
) -> Single:
    """Return the narrower side of what each pixel's chains of one track reach.

    A parallelogram's points, evenly spread, have a variance of a twelfth of a side's square.
    """
    groups = pixel.astype(np.uint64) << np.uint64(32) | track
    _, group, count = np.unique(groups, return_inverse=True, return_counts=True)

    def mean(values: Double) -> Double:
        return np.stack([np.bincount(group, each, len(count)) / count for each in values.T], axis=1)

    centred = place - mean(place.astype(np.float64))[group]
    products = (centred[:, :, None] * centred[:, None, :]).reshape(-1, 9)
    spreads = np.linalg.eigvalsh(mean(products).reshape(-1, 3, 3))[:, 1]
    sides = np.sqrt(12 * np.maximum(spreads, 0))[group]
    sides = np.where(count[group] < _FEW, unbent, sides)
    return np.clip(sides, _LEAST * unbent, _MOST * unbent).astype(np.float32)
