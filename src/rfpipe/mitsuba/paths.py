"""Light transport recorded along paths from the camera, between surfaces and through bodies.

Each vertex of a path is connected with a projector: camera pixel, projector pixel and throughput
are added to the matrix. Light that comes to its last surface by a mirror or a lens has no such
connection; `rfpipe.mitsuba.caustics` follows it from the projector.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from rfpipe.mitsuba.beams import Rig, Sums, begin, is_unbent, survival

_MOST_BOUNDARIES = 16  # that light to a projector passes through


def trace_paths(rig: Rig, sums: Sums, samples: int, seed: int) -> None:
    """Trace `samples` paths from each camera pixel of `sums`; add what they carry to its row."""
    row, ray, sampler = begin(rig.camera, sums.first, sums.count, samples, seed)
    context = mi.BSDFContext()

    def bounce(ray: Any, weight: Any, done: Any, active: Any, sampler: Any) -> tuple[Any, ...]:
        si = rig.scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        look = rig.projector.look(sampler.next_1d(), si.p)
        to_light = si.to_local(dr.normalize(look.origin - si.p))
        lit = active & look.seen & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light = weight * bsdf.eval(context, si, to_light, lit) * (look.flux * rig.projector.count)
        lit &= dr.any(light > 0)
        lit &= ~rig.scene.ray_test(si.spawn_ray_to(look.origin), lit)
        sums.add(row, look.pixel, light, lit)

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        weight, done = weight * value, done + 1
        goes_on = survival(weight, done)
        active &= dr.any(weight > 0) & (done < rig.bounces) & (sampler.next_1d() < goes_on)
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / goes_on, done, active, sampler

    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )


def trace_volumes(rig: Rig, sums: Sums, samples: int, seed: int) -> None:
    """Trace paths as `trace_paths` does, through translucent bodies, too.

    A body is filled with a homogeneous medium, within a boundary that doesn't bend light. Each
    scattering is a bounce, a boundary that lets light pass unbent is none. How far a path goes is
    drawn for a random colour channel, and weighed by the mean over all three. The camera stands
    outside.
    """
    row, ray, sampler = begin(rig.camera, sums.first, sums.count, samples, seed)
    context, phase_context = mi.BSDFContext(), mi.PhaseFunctionContext()

    def bounce(
        ray: Any, weight: Any, done: Any, medium: Any, active: Any, sampler: Any
    ) -> tuple[Any, ...]:
        si = rig.scene.ray_intersect(ray, active)
        within = active & (medium != None)  # noqa: E711 - an array of pointers
        scattered, distance, passed = _fly(medium, si, within, sampler)
        weight = weight * passed
        surface = active & ~scattered & si.is_valid()
        active = scattered | surface

        interaction = dr.zeros(mi.MediumInteraction3f)
        interaction.p = ray(distance)
        interaction.wi = -ray.d
        interaction.sh_frame = mi.Frame3f(interaction.wi)
        interaction.t, interaction.medium = distance, medium
        phase, bsdf = medium.phase_function(), si.bsdf(ray)
        place = dr.select(scattered, interaction.p, si.p)

        look = rig.projector.look(sampler.next_1d(), place)
        way = dr.normalize(look.origin - place)
        on_surface = surface & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        reflected = bsdf.eval(context, si, si.to_local(way), on_surface)
        toward, _ = phase.eval_pdf(phase_context, interaction, way, scattered)
        light = weight * dr.select(scattered, mi.Color3f(toward), reflected)
        lit = (scattered | on_surface) & look.seen & dr.any(light > 0)
        start = dr.select(scattered, mi.Ray3f(place, way), si.spawn_ray_to(look.origin))
        start.d = way
        outside = dr.select(scattered, medium, si.target_medium(way))
        light *= _transmittance(rig.scene, start, look.origin, outside, lit)
        light *= look.flux * rig.projector.count
        sums.add(row, look.pixel, light, lit & dr.any(light > 0))

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), surface)
        turned, turned_weight, _ = phase.sample(
            phase_context, interaction, sampler.next_1d(), sampler.next_2d(), scattered
        )
        onward = si.spawn_ray(si.to_world(sample.wo))
        medium = dr.select(surface & si.is_medium_transition(), si.target_medium(onward.d), medium)
        ray = dr.select(scattered, mi.Ray3f(interaction.p, turned), onward)
        weight *= dr.select(scattered, mi.Color3f(turned_weight), value)
        unbent = surface & is_unbent(sample)
        done = dr.select(unbent, done, done + 1)
        goes_on = dr.select(unbent, mi.Float(1), survival(weight, done))
        active &= dr.any(weight > 0) & (done < rig.bounces) & (sampler.next_1d() < goes_on)
        return ray, weight / goes_on, done, medium, active, sampler

    outside = dr.zeros(mi.MediumPtr, sums.count * samples)
    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), outside, mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )


def _fly(medium: Any, si: Any, within: Any, sampler: Any) -> tuple[Any, Any, Any]:
    """Draw how far light goes in a medium: whether it is scattered, where, and its weight."""
    channel = dr.minimum(mi.UInt32(sampler.next_1d() * 3), 2)
    scattering, extinction = _coefficients(medium, within)
    rate = dr.select(
        channel == 0, extinction.x, dr.select(channel == 1, extinction.y, extinction.z)
    )
    distance = -dr.log(1 - sampler.next_1d()) / dr.maximum(rate, 1e-20)
    scattered = within & (distance < si.t)
    distance = dr.select(scattered, distance, si.t)
    share = dr.select(within, dr.exp(-extinction * dr.minimum(distance, 1e9)), mi.Color3f(1))
    density = dr.select(scattered, share * extinction, share)
    weight = dr.select(scattered, share * scattering, share) / dr.maximum(dr.mean(density), 1e-30)
    return scattered, distance, dr.select(within, weight, mi.Color3f(1))


def _coefficients(medium: Any, active: Any) -> tuple[Any, Any]:
    """Return how much a homogeneous medium scatters, and takes off in all, per unit of length."""
    interaction = dr.zeros(mi.MediumInteraction3f)
    scattering, _, extinction = medium.get_scattering_coefficients(interaction, active)
    return mi.Color3f(scattering), mi.Color3f(extinction)


def _transmittance(scene: Any, ray: Any, target: Any, medium: Any, active: Any) -> Any:
    """Return the share of light that gets straight from a ray's origin to a target."""

    def advance(ray: Any, share: Any, medium: Any, passed: Any, active: Any) -> tuple[Any, ...]:
        rest = dr.norm(target - ray.o)
        ray.maxt = rest * (1 - 1e-4)
        si = scene.ray_intersect(ray, active)
        hit = active & si.is_valid()
        within = active & (medium != None)  # noqa: E711 - an array of pointers
        _, extinction = _coefficients(medium, within)
        length = dr.select(hit, si.t, rest)
        share = dr.select(within, share * dr.exp(-extinction * length), share)
        through = si.bsdf(ray).eval_null_transmission(si, hit)
        share = dr.select(hit, share * through, share)
        medium = dr.select(hit & si.is_medium_transition(), si.target_medium(ray.d), medium)
        ray = dr.select(hit, si.spawn_ray(ray.d), ray)
        passed = passed + 1
        active = hit & dr.any(share > 0) & (passed < _MOST_BOUNDARIES)
        share = dr.select(hit & (passed >= _MOST_BOUNDARIES), mi.Color3f(0), share)
        return ray, share, medium, passed, active

    return dr.while_loop(
        (ray, mi.Color3f(1), medium, mi.UInt32(0), active),
        lambda *state: state[-1],
        advance,
    )[1]
