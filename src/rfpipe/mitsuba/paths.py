"""Path tracing of the transport matrix from the camera, at surfaces and in translucent bodies.

Each vertex of a path is connected with a projector, and its throughput is added to the matrix entry
of camera pixel and projector pixel. Light that reaches its last surface by a mirror or a lens has
no such connection; `rfpipe.mitsuba.caustics` traces it from the projector.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from rfpipe.mitsuba.beams import Sums, TracedScene, begin, passes_straight, survival

_MAX_BOUNDARIES = 16  # boundaries between a vertex and a projector


def trace_paths(rig: TracedScene, sums: Sums, samples: int, seed: int) -> None:
    """Trace `samples` paths from each camera pixel of `sums`; add their light to its row."""
    row, ray, sampler = begin(rig.camera, sums.first, sums.count, samples, seed)
    context = mi.BSDFContext()

    def bounce(ray: Any, weight: Any, bounces: Any, active: Any, sampler: Any) -> tuple[Any, ...]:
        si = rig.scene.ray_intersect(ray, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        view = rig.projector.project(si.p, sampler)
        to_light = si.to_local(dr.normalize(view.origin - si.p))
        lit = active & view.inside & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light = weight * bsdf.eval(context, si, to_light, lit) * (view.flux * rig.projector.count)
        lit &= dr.any(light > 0)
        lit &= ~rig.scene.ray_test(si.spawn_ray_to(view.origin), lit)
        sums.add(row, view.pixel, light, lit)

        sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        weight, bounces = weight * value, bounces + 1
        probability = survival(weight, bounces)
        active &= dr.any(weight > 0) & (bounces < rig.bounces) & (sampler.next_1d() < probability)
        ray = si.spawn_ray(si.to_world(sample.wo))
        return ray, weight / probability, bounces, active, sampler

    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )


def trace_volumes(rig: TracedScene, sums: Sums, samples: int, seed: int) -> None:
    """Trace paths as `trace_paths` does, including scattering within translucent bodies.

    A body is a homogeneous medium within a boundary that doesn't refract. Each scattering counts as
    a bounce; passing a boundary straight doesn't. Free path lengths are sampled for a random colour
    channel and weighted by the mean over all three. The camera must be outside all bodies.
    """
    row, ray, sampler = begin(rig.camera, sums.first, sums.count, samples, seed)

    def bounce(
        ray: Any, weight: Any, bounces: Any, medium: Any, active: Any, sampler: Any
    ) -> tuple[Any, ...]:
        si = rig.scene.ray_intersect(ray, active)
        inside = active & (medium != None)  # noqa: E711 - an array of pointers
        scattered, distance, attenuation = _sample_distance(medium, si, inside, sampler)
        weight = weight * attenuation
        vertex = _vertex(ray, si, medium, distance, scattered, active)
        active = scattered | vertex.on_surface

        pixel, light, lit = _connect(rig, vertex, weight, sampler)
        sums.add(row, pixel, light, lit)

        ray, medium, value, straight = _continue(vertex, sampler)
        weight *= value
        bounces = dr.select(straight, bounces, bounces + 1)
        probability = dr.select(straight, mi.Float(1), survival(weight, bounces))
        active &= dr.any(weight > 0) & (bounces < rig.bounces) & (sampler.next_1d() < probability)
        return ray, weight / probability, bounces, medium, active, sampler

    outside = dr.zeros(mi.MediumPtr, sums.count * samples)
    dr.while_loop(
        (ray, mi.Color3f(1), mi.UInt32(0), outside, mi.Bool(True), sampler),
        lambda *state: state[-2],
        bounce,
    )


class _Vertex(NamedTuple):
    """Vertices of paths, each within a medium (`scattered`) or on a surface (`on_surface`).

    Attributes
    ----------
    si : SurfaceInteraction3f
    interaction : MediumInteraction3f
    bsdf, phase : BSDFPtr, PhaseFunctionPtr
        Of the surface and of the medium.
    medium : MediumPtr
        Medium of the path before the vertex; null outside bodies.
    scattered, on_surface : Bool
    """

    si: Any
    interaction: Any
    bsdf: Any
    phase: Any
    medium: Any
    scattered: Any
    on_surface: Any


def _vertex(ray: Any, si: Any, medium: Any, distance: Any, scattered: Any, active: Any) -> _Vertex:
    """Build the next vertices of paths from the sampled distances along their rays."""
    interaction = dr.zeros(mi.MediumInteraction3f)
    interaction.p = ray(distance)
    interaction.wi = -ray.d
    interaction.sh_frame = mi.Frame3f(interaction.wi)
    interaction.t, interaction.medium = distance, medium
    on_surface = active & ~scattered & si.is_valid()
    return _Vertex(
        si, interaction, si.bsdf(ray), medium.phase_function(), medium, scattered, on_surface
    )


def _connect(rig: TracedScene, vertex: _Vertex, weight: Any, sampler: Any) -> tuple[Any, Any, Any]:
    """Connect vertices with a projector; return projector pixels, light, and where it is lit."""
    si, interaction, scattered = vertex.si, vertex.interaction, vertex.scattered
    point = dr.select(scattered, interaction.p, si.p)
    view = rig.projector.project(point, sampler)
    direction = dr.normalize(view.origin - point)
    diffuse = vertex.on_surface & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Smooth)
    reflected = vertex.bsdf.eval(mi.BSDFContext(), si, si.to_local(direction), diffuse)
    context = mi.PhaseFunctionContext()
    phase, _ = vertex.phase.eval_pdf(context, interaction, direction, scattered)
    light = weight * dr.select(scattered, mi.Color3f(phase), reflected)
    lit = (scattered | diffuse) & view.inside & dr.any(light > 0)
    ray = dr.select(scattered, mi.Ray3f(point, direction), si.spawn_ray_to(view.origin))
    ray.d = direction
    medium = dr.select(scattered, vertex.medium, si.target_medium(direction))
    light *= _transmittance(rig.scene, ray, view.origin, medium, lit)
    light *= view.flux * rig.projector.count
    return view.pixel, light, lit & dr.any(light > 0)


def _continue(vertex: _Vertex, sampler: Any) -> tuple[Any, Any, Any, Any]:
    """Sample the next rays; return rays, media, factors, and where boundaries don't refract."""
    si, interaction = vertex.si, vertex.interaction
    scattered, on_surface = vertex.scattered, vertex.on_surface
    sample, reflectance = vertex.bsdf.sample(
        mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), on_surface
    )
    direction, phase_weight, _ = vertex.phase.sample(
        mi.PhaseFunctionContext(), interaction, sampler.next_1d(), sampler.next_2d(), scattered
    )
    reflected = si.spawn_ray(si.to_world(sample.wo))
    crosses = on_surface & si.is_medium_transition()
    medium = dr.select(crosses, si.target_medium(reflected.d), vertex.medium)
    ray = dr.select(scattered, mi.Ray3f(interaction.p, direction), reflected)
    factor = dr.select(scattered, mi.Color3f(phase_weight), reflectance)
    return ray, medium, factor, on_surface & passes_straight(sample)


def _sample_distance(medium: Any, si: Any, inside: Any, sampler: Any) -> tuple[Any, Any, Any]:
    """Sample free path lengths; return where light scatters, the distances, and the weights."""
    channel = dr.minimum(mi.UInt32(sampler.next_1d() * 3), 2)
    scattering, extinction = _coefficients(medium, inside)
    rate = dr.select(
        channel == 0, extinction.x, dr.select(channel == 1, extinction.y, extinction.z)
    )
    distance = -dr.log(1 - sampler.next_1d()) / dr.maximum(rate, 1e-20)
    scattered = inside & (distance < si.t)
    distance = dr.select(scattered, distance, si.t)
    transmittance = dr.select(
        inside, dr.exp(-extinction * dr.minimum(distance, 1e9)), mi.Color3f(1)
    )
    density = dr.select(scattered, transmittance * extinction, transmittance)
    weight = dr.select(scattered, transmittance * scattering, transmittance)
    weight /= dr.maximum(dr.mean(density), 1e-30)
    return scattered, distance, dr.select(inside, weight, mi.Color3f(1))


def _coefficients(medium: Any, active: Any) -> tuple[Any, Any]:
    """Scattering and extinction coefficients of a homogeneous medium, per scene unit."""
    interaction = dr.zeros(mi.MediumInteraction3f)
    scattering, _, extinction = medium.get_scattering_coefficients(interaction, active)
    return mi.Color3f(scattering), mi.Color3f(extinction)


def _transmittance(scene: Any, ray: Any, target: Any, medium: Any, active: Any) -> Any:
    """Transmittance along rays from their origins to a target."""

    def advance(ray: Any, share: Any, medium: Any, boundaries: Any, active: Any) -> tuple[Any, ...]:
        remaining = dr.norm(target - ray.o)
        ray.maxt = remaining * (1 - 1e-4)
        si = scene.ray_intersect(ray, active)
        hit = active & si.is_valid()
        inside = active & (medium != None)  # noqa: E711 - an array of pointers
        _, extinction = _coefficients(medium, inside)
        length = dr.select(hit, si.t, remaining)
        share = dr.select(inside, share * dr.exp(-extinction * length), share)
        through = si.bsdf(ray).eval_null_transmission(si, hit)
        share = dr.select(hit, share * through, share)
        medium = dr.select(hit & si.is_medium_transition(), si.target_medium(ray.d), medium)
        ray = dr.select(hit, si.spawn_ray(ray.d), ray)
        boundaries = boundaries + 1
        active = hit & dr.any(share > 0) & (boundaries < _MAX_BOUNDARIES)
        share = dr.select(hit & (boundaries >= _MAX_BOUNDARIES), mi.Color3f(0), share)
        return ray, share, medium, boundaries, active

    return dr.while_loop(
        (ray, mi.Color3f(1), medium, mi.UInt32(0), active),
        lambda *state: state[-1],
        advance,
    )[1]
