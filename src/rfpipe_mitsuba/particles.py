"""Light that the projector throws by mirrors and lenses, followed from the projector.

A path from the camera can't find it, since it meets a projector, a point, by chance only. So paths
start at the projector's pixels too. Those that a mirror or a lens bends first are connected with
the camera at each surface that scatters light, and merged with what the camera sees there by
mirrors and lenses of its own. Each path of light is found in one way: from the camera, if its last
surface before the projector scatters; else by connection, if its first surface before the camera
does; else by merging, where the camera's chain ends. What fills bodies plays no part.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from rfpipe_mitsuba.merging import Ends
from rfpipe_mitsuba.paths import begin, is_bent, is_unbent, survival
from rfpipe_mitsuba.pinholes import Pinholes
from rfpipe_mitsuba.sums import Sums

__all__ = ["trace_particles"]

_LEAST_COSINE = 1e-4


def trace_particles(
    scene: Any,
    camera: Pinholes,
    projector: Pinholes,
    sums: Sums,
    *,
    ends: Ends | None,
    samples: int,
    bounces: int,
    seed: int,
) -> None:
    """Trace light from the projector's pixels, and add what it throws to columns of the matrix.

    Parameters
    ----------
    scene
        Mitsuba's scene of surfaces; what fills bodies plays no part.
    sums
        Sums over `samples` paths for each of its columns, which are projector pixels.
    ends
        Of the camera's chains, to be merged with; None if there is none.
    samples
        Paths a pixel.
    bounces
        Most vertices of a path between projector and camera.
    seed
        Of the random numbers.
    """
    column, ray, sampler = begin(projector, sums.first, sums.count, samples, seed)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    cameras = len(camera.views.views)
    # A pixel sends what falls on its square of the image plane, and takes the mean over its own.
    sent = projector.views.pitch**2
    per_pixel = sent / camera.views.pitch**2 * cameras

    def merge(
        ends: Ends, si: Any, bsdf: Any, weight: Any, done: Any, active: Any, sampler: Any
    ) -> Any:
        def at_level(level: Any, sampler: Any) -> tuple[Any, ...]:
            near = ends.near(si, level, sampler.next_1d(active), active)
            found = near.found & (done + near.bounces < bounces)
            to_camera = si.to_local(near.way)
            # What a disc gets doesn't depend on the slant that it is seen at.
            slant = dr.maximum(dr.abs(to_camera.z), _LEAST_COSINE)
            seen = bsdf.eval(context, si, to_camera, found) / slant
            sums.add(column, near.pixel, weight * seen * near.weight * sent, found)
            return level + 1, sampler

        return dr.while_loop(
            (mi.UInt32(0), sampler),
            lambda level, _sampler: active & (level < ends.levels),
            at_level,
        )[1]

    def bounce(
        ray: Any, weight: Any, done: Any, bent: Any, active: Any, sampler: Any
    ) -> tuple[Any, ...]:
        si = scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        look = camera.look(camera.choose(sampler.next_1d()), si.p)
        to_camera = si.to_local(dr.normalize(look.origin - si.p))
        scatters = active & bent & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        seen = scatters & look.seen
        light = weight * bsdf.eval(context, si, to_camera, seen) * (look.flux * per_pixel)
        seen &= dr.any(light > 0)
        seen &= ~scene.ray_test(si.spawn_ray_to(look.origin), seen)
        sums.add(column, look.pixel, light, seen)
        if ends is not None:
            sampler = merge(ends, si, bsdf, weight, done, scatters, sampler)

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        unbent = is_unbent(sample)
        weight, done = weight * value, dr.select(unbent, done, done + 1)
        # Light whose first surface isn't bent by it is found from the camera.
        bent |= is_bent(sample) & (done == 1)
        goes_on = dr.select(unbent, mi.Float(1), survival(weight, done))
        active &= (bent | (done == 0)) & dr.any(weight > 0) & (done < bounces)
        active &= sampler.next_1d() < goes_on
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / goes_on, done, bent, active, sampler

    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(False), mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )
