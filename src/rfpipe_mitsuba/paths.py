"""Light transport recorded along paths from the camera, between surfaces.

Each vertex of a path is connected with a projector: camera pixel, projector pixel and throughput
are added to the matrix. Light that comes to its last surface by a mirror or a lens has no such
connection; `rfpipe_mitsuba.particles` follows it from the projector.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from rfpipe_mitsuba.pinholes import Pinholes
from rfpipe_mitsuba.sums import Sums

__all__ = ["begin", "is_bent", "is_unbent", "survival", "trace_paths"]

_ROULETTE = 4  # bounces after which a dim path may end early


def begin(
    pinholes: Pinholes, first: int, count: int, samples: int, seed: int
) -> tuple[Any, Any, Any]:
    """Begin paths, `samples` for each of `count` pixels from a first one on.

    Returns which of these pixels it is, counted from the first, rays, and random numbers.
    """
    lanes = count * samples
    row = dr.arange(mi.UInt32, lanes) // samples
    sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
    sampler.set_samples_per_wavefront(samples)
    sampler.seed(seed, lanes)
    pixel = row + dr.opaque(mi.UInt32, first)
    return row, pinholes.rays(pixel, sampler.next_2d()), sampler


def survival(weight: Any, done: Any) -> Any:
    """Probability that a path goes on after some bounces (Russian roulette)."""
    return dr.select(done >= _ROULETTE, dr.clip(dr.max(weight), 0.05, 0.95), mi.Float(1))


def is_bent(sample: Any) -> Any:
    """Tell whether a surface turned light as a mirror or a lens does."""
    kind = sample.sampled_type
    reflected = mi.has_flag(kind, mi.BSDFFlags.DeltaReflection)
    return reflected | mi.has_flag(kind, mi.BSDFFlags.DeltaTransmission)


def is_unbent(sample: Any) -> Any:
    """Tell whether light passed a boundary straight on, which counts as no bounce."""
    return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)


def trace_paths(
    scene: Any,
    camera: Pinholes,
    projector: Pinholes,
    sums: Sums,
    *,
    samples: int,
    bounces: int,
    seed: int,
) -> None:
    """Trace paths from the camera's pixels, and add what they carry to rows of the matrix.

    Parameters
    ----------
    scene
        Mitsuba's scene of surfaces; its own emitters play no part.
    sums
        Sums over `samples` paths for each of its rows, which are camera pixels.
    samples
        Paths a pixel.
    bounces
        Most vertices of a path, at least 1: direct light alone.
    seed
        Of the random numbers.
    """
    row, ray, sampler = begin(camera, sums.first, sums.count, samples, seed)
    context = mi.BSDFContext()
    projectors = len(projector.views.views)

    def bounce(ray: Any, weight: Any, done: Any, active: Any, sampler: Any) -> tuple[Any, ...]:
        si = scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        look = projector.look(projector.choose(sampler.next_1d()), si.p)
        to_light = si.to_local(dr.normalize(look.origin - si.p))
        lit = active & look.seen & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light = weight * bsdf.eval(context, si, to_light, lit) * (look.flux * projectors)
        lit &= dr.any(light > 0)
        lit &= ~scene.ray_test(si.spawn_ray_to(look.origin), lit)
        sums.add(row, look.pixel, light, lit)

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        weight, done = weight * value, done + 1
        goes_on = survival(weight, done)
        active &= dr.any(weight > 0) & (done < bounces) & (sampler.next_1d() < goes_on)
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / goes_on, done, active, sampler

    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )
