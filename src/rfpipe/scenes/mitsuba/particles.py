"""Caustics: light that a mirror or a lens throws on a surface, followed from the projector.

A path from the camera can't find it, since it meets a projector, a point, by chance only. So paths
start at the projector's pixels too; as long as mirrors and lenses alone bend them, the first other
surface is connected with the camera, and so are those that follow. Both kinds of paths together
carry all light but that which projector and camera both send and see through mirrors and lenses, to
and from the same piece of surface: that isn't traced.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from rfpipe.scenes.mitsuba.paths import begin, survival
from rfpipe.scenes.mitsuba.pinholes import Pinholes
from rfpipe.scenes.mitsuba.sums import Sums

__all__ = ["trace_particles"]


def trace_particles(
    scene: Any,
    camera: Pinholes,
    projector: Pinholes,
    sums: Sums,
    *,
    samples: int,
    bounces: int,
    seed: int,
) -> None:
    """Trace light from the projector's pixels, and add caustics to columns of the matrix.

    Parameters
    ----------
    scene
        Mitsuba's scene of surfaces; what fills bodies plays no part.
    sums
        Sums over `samples` paths for each of its columns, which are projector pixels.
    samples
        Paths a pixel.
    bounces
        Most vertices of a path between projector and camera.
    seed
        Of the random numbers.
    """
    column, ray, sampler = begin(projector, sums, samples, seed)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    cameras = len(camera.views.views)
    # A pixel sends what falls on its square of the image plane, and takes the mean over its own.
    per_pixel = projector.views.pitch**2 / camera.views.pitch**2 * cameras

    def bounce(
        ray: Any, weight: Any, done: Any, bent: Any, active: Any, sampler: Any
    ) -> tuple[Any, ...]:
        si = scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        look = camera.look(camera.choose(sampler.next_1d()), si.p)
        to_camera = si.to_local(dr.normalize(look.origin - si.p))
        seen = active & bent & look.seen & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light = weight * bsdf.eval(context, si, to_camera, seen) * (look.flux * per_pixel)
        seen &= dr.any(light > 0)
        seen &= ~scene.ray_test(si.spawn_ray_to(look.origin), seen)
        sums.add(column, look.pixel, light, seen)

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        weight, done = weight * value, done + 1
        # Light whose first surface isn't bent by it is found from the camera.
        bent |= mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (done == 1)
        goes_on = survival(weight, done)
        active &= bent & dr.any(weight > 0) & (done < bounces) & (sampler.next_1d() < goes_on)
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / goes_on, done, bent, active, sampler

    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(False), mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )
