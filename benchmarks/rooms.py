"""Small matrices of physically based light: rooms with gloss, translucency, mirrors and lenses.

Each is the exact, symmetric transport of a coaxial rig. Rays end on texels, those of mirrors and
glass where they lead, which makes sharp peaks and caustics off the diagonal: ``T = P K P^T``, with
P the share of each texel in a ray, and K the light between texels: direct, reflected diffusely any
number of times, by Phong lobes once, and scattered below the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NEAR = 1e-6
_FARTHEST = 1e9
_WALLS = {  # normal and distance from the camera of a room that is open towards it
    "back": ((0, 0, -1), -4.0),
    "left": ((1, 0, 0), -1.3),
    "right": ((-1, 0, 0), -1.3),
    "floor": ((0, -1, 0), -1.1),
    "ceiling": ((0, 1, 0), -1.1),
}


@dataclass(frozen=True)
class Box:
    """A block with its sides along the axes, turned about the vertical by some degrees."""

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    turned: float = 0.0


@dataclass(frozen=True)
class Ball:
    """A sphere: "matt", "translucent", a "mirror", or of "glass"."""

    centre: tuple[float, float, float]
    radius: float
    of: str = "matt"


@dataclass(frozen=True)
class Room:
    """A room, what stands in it and what its walls are like.

    `gloss` is the share of light that walls reflect in a lobe, `exponent` its Phong exponent,
    `scatter` the mean free path in translucent balls, `grain` the relative standard deviation of
    single entries, as random sampling leaves it, `mirror` a wall that is one.
    """

    things: tuple[Box | Ball, ...] = ()
    gloss: float = 0.0
    exponent: float = 0.0
    scatter: float = 0.2
    grain: float = 0.0
    mirror: str = ""
    seed: int = 0
    tags: tuple[str, ...] = field(default=())


def transport(room: Room, shape: tuple[int, int]) -> Array:
    """Return the matrix (N, N) of a room, float64, its largest row sum 1."""
    rays = _rays(shape)
    origin = np.zeros_like(rays)
    points, normals, surface = _hits(room, origin, rays)
    bent = np.isin(surface, _specular(room))
    share = np.ones(len(rays))
    ends, end_normals, end_surface, towards = points, normals, surface, rays
    for _ in range(2):  # a mirror in a mirror, and no further
        if not bent.any():
            break
        start, onward = _bend(room, ends[bent], end_normals[bent], end_surface[bent], towards[bent])
        ends, end_normals, end_surface, towards = (
            a.copy() for a in (ends, end_normals, end_surface, towards)
        )
        ends[bent], end_normals[bent], end_surface[bent] = _hits(room, start, onward)
        towards[bent] = onward
        share[bent] *= 0.9
        bent = np.isin(end_surface, _specular(room))
    share[bent] = 0.0
    footprints, own = _footprints(shape, points, surface, ends, end_surface, share)
    light = _light(room, shape, ends, end_normals, end_surface, towards, own)
    matrix: Array = footprints @ light @ footprints.T
    if room.grain:
        grain = np.random.default_rng(room.seed).standard_normal(matrix.shape)
        matrix *= np.maximum(1 + room.grain * (grain + grain.T) / np.sqrt(2), 0)
    return matrix / matrix.sum(axis=1).max()


def _rays(shape: tuple[int, int]) -> Array:
    """Directions (N, 3) of a camera at the origin that looks along z."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    short = min(shape)
    x, y = (columns - shape[1] / 2) / short, (rows - shape[0] / 2) / short
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    return _unit(rays)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _specular(room: Room) -> list[int]:
    """Numbers of the surfaces that only pass light on."""
    things = [
        len(_WALLS) + i
        for i, thing in enumerate(room.things)
        if isinstance(thing, Ball) and thing.of in ("mirror", "glass")
    ]
    return things + [i for i, name in enumerate(_WALLS) if name == room.mirror]


def _hits(room: Room, start: Array, rays: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return where rays end: points, normals and surfaces, the walls first."""
    nearest = np.full(len(rays), _FARTHEST)
    normals, surface = np.zeros_like(rays), np.full(len(rays), -1)
    found = []
    for normal, distance in _WALLS.values():
        across = rays @ np.array(normal, float)
        ahead = across < -_NEAR
        length = np.full(len(rays), _FARTHEST)
        np.divide(distance - start @ np.array(normal, float), across, out=length, where=ahead)
        found.append((length, np.broadcast_to(np.array(normal, float), rays.shape)))
    found += [_thing_hits(thing, start, rays) for thing in room.things]
    for number, (length, of_thing) in enumerate(found):
        closer = (length > _NEAR) & (length < nearest)
        nearest[closer], normals[closer], surface[closer] = length[closer], of_thing[closer], number
    return start + nearest[:, None] * rays, normals, surface


def _thing_hits(thing: Box | Ball, start: Array, rays: Array) -> tuple[Array, Array]:
    """Return the distance along rays to a thing, `_FARTHEST` for none, and its normals there."""
    if isinstance(thing, Ball):
        apart = start - np.array(thing.centre)
        along = np.einsum("na,na->n", apart, rays)
        inside = along**2 - np.einsum("na,na->n", apart, apart) + thing.radius**2
        length = np.where(inside > 0, -along - np.sqrt(np.maximum(inside, 0)), _FARTHEST)
        length[length < 1e-4] = _FARTHEST
        return length, _unit(apart + length[:, None] * rays)
    turn = _turn(thing)
    at, direction = (start - np.array(thing.centre)) @ turn, rays @ turn
    direction = np.where(np.abs(direction) < _NEAR, _NEAR, direction)
    sides = np.stack([(s * np.array(thing.half) - at) / direction for s in (-1, 1)])
    entry, leave = sides.min(axis=0), sides.max(axis=0)
    length = entry.max(axis=1)
    length[(length > leave.min(axis=1)) | (length < 1e-4)] = _FARTHEST
    axis = entry.argmax(axis=1)
    normals = np.zeros_like(rays)
    rows = np.arange(len(rays))
    normals[rows, axis] = -np.sign(direction[rows, axis])
    return length, normals @ turn.T


def _turn(box: Box) -> Array:
    cosine, sine = np.cos(np.radians(box.turned)), np.sin(np.radians(box.turned))
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


def _bend(
    room: Room, points: Array, normals: Array, surface: NDArray[np.int64], rays: Array
) -> tuple[Array, Array]:
    """Reflect rays at mirrors; lead them through glass balls, of index 1.5, and out again."""
    onward = rays - 2 * np.einsum("na,na->n", rays, normals)[:, None] * normals
    start = points.copy()
    for number in _specular(room):
        thing = room.things[number - len(_WALLS)] if number >= len(_WALLS) else None
        if not isinstance(thing, Ball) or thing.of != "glass":
            continue
        own = surface == number
        within = _refract(rays[own], normals[own], 1 / 1.5)
        apart = points[own] - np.array(thing.centre)
        length = -2 * np.einsum("na,na->n", apart, within)
        start[own] = points[own] + length[:, None] * within
        onward[own] = _refract(within, -(start[own] - np.array(thing.centre)) / thing.radius, 1.5)
    return start + 1e-5 * onward, onward


def _refract(rays: Array, normals: Array, index: float) -> Array:
    cosine = -np.einsum("na,na->n", rays, normals)
    within = np.sqrt(np.maximum(1 - index**2 * (1 - cosine**2), 0))
    return _unit(index * rays + (index * cosine - within)[:, None] * normals)


def _footprints(
    shape: tuple[int, int],
    points: Array,
    surface: NDArray[np.int64],
    ends: Array,
    end_surface: NDArray[np.int64],
    share: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return P (N, N), texels in rays, and whose texel is the ray's own.

    A ray that ends where the camera looks directly shares the four texels there.
    """
    n, short = len(points), min(shape)
    x = ends[:, 0] / ends[:, 2] * short + shape[1] / 2 - 0.5
    y = ends[:, 1] / ends[:, 2] * short + shape[0] / 2 - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    bent = np.abs(points - ends).max(axis=1) > _NEAR
    footprints = np.diag(share)
    own = np.ones(n, np.bool_)
    for ray in np.flatnonzero(bent & (share > 0)):
        r, c = row[ray], column[ray]
        if ends[ray, 2] <= 0 or not (0 <= r < shape[0] - 1 and 0 <= c < shape[1] - 1):
            continue
        texels = np.array([r * shape[1] + c, r * shape[1] + c + 1])
        texels = np.concatenate([texels, texels + shape[1]])
        if not (surface[texels] == end_surface[ray]).all():
            continue
        right, down = x[ray] - c, y[ray] - r
        weights = np.outer([1 - down, down], [1 - right, right]).ravel()
        footprints[ray] = 0
        footprints[ray, texels] = share[ray] * weights
        own[ray] = False
    return footprints, own


def _light(
    room: Room,
    shape: tuple[int, int],
    points: Array,
    normals: Array,
    surface: NDArray[np.int64],
    rays: Array,
    own: NDArray[np.bool_],
) -> Array:
    """Return the light between texels (N, N)."""
    n = len(points)
    rng = np.random.default_rng(room.seed)
    albedo = rng.choice([0.25, 0.5, 0.8], n) * (0.9 - 0.1 * (surface % 3))
    facing = np.maximum(-np.einsum("na,na->n", rays, normals), 0.05)
    area = np.square(np.linalg.norm(points, axis=1) / min(shape)) / facing * own
    between = points[None] - points[:, None]
    square = np.maximum(np.einsum("ijk,ijk->ij", between, between), np.median(area))
    towards = between / np.sqrt(square)[..., None]
    leaving = np.maximum(np.einsum("ijk,ik->ij", towards, normals), 0)
    seen = _visible(room, points, normals)
    factors = seen * leaving * leaving.T / (np.pi * square)
    bounces = np.linalg.solve(
        np.eye(n) - albedo[:, None] * factors * area, albedo[:, None] * factors
    )
    light = albedo * bounces  # all orders from the second on
    if room.gloss:
        mirrored = rays - 2 * np.einsum("na,na->n", rays, normals)[:, None] * normals
        lobe = np.maximum(np.einsum("ijk,ik->ij", towards, mirrored), 0) ** room.exponent
        lobe *= room.gloss * (room.exponent + 2) / 2 * (surface < len(_WALLS))[:, None]
        glossy = (albedo[:, None] + lobe) * factors * (albedo[:, None] + lobe).T
        light += glossy - albedo[:, None] * factors * albedo
    for number, thing in enumerate(room.things):
        if isinstance(thing, Ball) and thing.of == "translucent":
            inside = (surface == len(_WALLS) + number).astype(float)
            reach = np.sqrt(square) + room.scatter / 4
            light += 0.02 * np.outer(inside, inside) * np.exp(-reach / room.scatter) / reach
    light[np.diag_indices(n)] += albedo / np.maximum(area, np.median(area))
    return (light + light.T) / 2


def _visible(room: Room, points: Array, normals: Array) -> Array:
    """Return 1 where two texels see each other, else 0."""
    n = len(points)
    seen = np.ones((n, n))
    lifted = points + 1e-4 * normals
    for thing in room.things:
        for i in range(n):
            span = lifted - lifted[i]
            distance = np.linalg.norm(span, axis=1)
            rays = span / np.maximum(distance, _NEAR)[:, None]
            length, _ = _thing_hits(thing, np.broadcast_to(lifted[i], span.shape), rays)
            seen[i, length < distance - 1e-3] = 0
    return np.minimum(seen, seen.T)
