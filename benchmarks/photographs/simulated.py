"""Simulated pictures of objects under single lights of a dome, with noise, in 8 bits.

Objects are spheres before an orthographic camera: matt, glossy, with sharp highlights, or as a
relief of many. They cast shadows on each other. Lamps have a distance of 5 times the object's
size and unequal power.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double

OBJECTS = ("blob", "few", "many", "gloss", "mirror", "cloth", "relief")
"""Kinds of objects."""

DOMES = ("sphere", "hemisphere", "rings", "random")
"""Arrangements of lights; all but the first are on the camera's side."""

_SPHERES = {"blob": 1, "few": 6, "many": 30, "gloss": 8, "mirror": 8, "cloth": 12, "relief": 120}
_BUMPS = {"cloth": 0.25, "many": 0.1, "relief": 0.15}
_HIGHLIGHTS = {
    "gloss": ((0.2, 1.2), (10, 60)),
    "relief": ((0.2, 1.2), (10, 60)),
    "mirror": ((1, 6), (100, 500)),
}
_DISTANCE = 5.0
"""Of the lamps, in object sizes."""


def dome_directions(kind: str, random: np.random.Generator, count: int = 64) -> Double:
    """Return unit vectors (count, 3) of an arrangement of `DOMES`."""
    index = np.arange(count)
    z, turn = random.uniform(0.05, 1, count), random.uniform(0, 2 * np.pi, count)
    if kind in ("sphere", "hemisphere"):
        z = 1 - (2 if kind == "sphere" else 0.92) * (index + 0.5) / count
        turn = index * np.pi * (3 - 5**0.5)
    if kind == "rings":
        lamps = np.rint(np.array([20, 17, 14, 9, 4]) * count / 64).astype(int)
        z = np.repeat(np.sin(np.radians([12, 27, 42, 57, 72])), lamps)
        turn = np.concatenate([2 * np.pi * np.arange(n) / n + random.random() for n in lamps])
    around = np.sqrt(1 - z**2)
    return _unit(np.stack([around * np.cos(turn), around * np.sin(turn), z], axis=1))


def simulated_dome(
    kind: str, dome: str, seed: int, power_deviation: float, side: int = 36
) -> tuple[NDArray[np.float32], Double]:
    """Return pictures (L, 3, pixels) of an object and the directions (L, 3) of the lights.

    Parameters
    ----------
    kind, dome : str
        Of `OBJECTS` and `DOMES`.
    seed : int
    power_deviation : float
        Standard deviation of the logarithm of the lamps' power.
    side : int
        Pixels of the picture's side; pixels beside the object are left out.
    """
    random = np.random.default_rng((seed, OBJECTS.index(kind), DOMES.index(dome)))
    directions = dome_directions(dome, random)
    scene = _scene(kind, random, side)
    places = directions * _DISTANCE * (1 + 0.03 * random.normal(size=(len(directions), 1)))
    power = np.exp(power_deviation * random.normal(size=len(directions)))
    light = np.array([p * _picture(scene, place) for p, place in zip(power, places, strict=True)])
    light *= 0.7 / np.quantile(light, 0.99)
    light += 0.004 * np.sqrt(light + 0.02) * random.normal(size=light.shape)
    return (np.rint(255 * np.clip(light, 0, 1)) / 255).astype(np.float32), directions


def _unit(vectors: Double) -> Double:
    unit: Double = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def _scene(kind: str, random: np.random.Generator, side: int) -> dict[str, Double]:
    """Return the points that the camera sees: places, normals, colours and highlights."""
    count = _SPHERES[kind]
    centres, radii = random.uniform(-0.8, 0.8, (count, 3)), random.uniform(0.15, 0.55, count)
    if kind == "relief":
        centres[:, :2] *= 1.3
        centres[:, 2] = random.uniform(-0.25, 0.1, count)
        radii = random.uniform(0.08, 0.3, count)
    if kind == "blob":
        centres, radii = np.zeros((1, 3)), np.array([0.95])
    if kind == "many":
        radii *= 0.6
    row, column = (0.97 - 1.94 * (place + 0.5) / side for place in np.indices((side, side)))
    pixels = np.stack([-column.ravel(), row.ravel()], axis=1)
    square = ((pixels[:, None] - centres[None, :, :2]) ** 2).sum(axis=-1)
    height = np.where(
        square < radii**2, centres[:, 2] + np.sqrt(np.maximum(radii**2 - square, 0)), -np.inf
    )
    visible, sphere = np.isfinite(height.max(axis=1)), height.argmax(axis=1)
    points = np.column_stack([pixels, height.max(axis=1)])[visible]
    sphere = sphere[visible]
    normals = (points - centres[sphere]) / radii[sphere, None]
    waves, phases = 8 * random.normal(size=(6, 3)), random.uniform(0, 2 * np.pi, 6)
    bumps = np.cos(points @ waves.T + phases) @ waves / 8 / 6**0.5
    normals = _unit(normals + _BUMPS.get(kind, 0.04) * bumps)
    normals[:, 2] = np.maximum(normals[:, 2], 0.02)
    texture = (0.3 + 0.7 * random.random(count)[sphere]) * (
        0.75 + 0.25 * np.sin(9 * points @ random.normal(size=3))
    )
    strength, exponent = _HIGHLIGHTS.get(kind, ((0.05, 0.05), (20, 20)))
    return {
        "points": points,
        "normals": _unit(normals),
        "sphere": sphere,
        "centres": centres,
        "radii": radii,
        "colours": texture * (0.5 + 0.5 * random.random((3, count))[:, sphere]),
        "strength": random.uniform(*strength, count)[sphere],
        "exponent": random.uniform(*exponent, count)[sphere],
        "wrap": np.array(0.3 if kind == "cloth" else 0.0),
    }


def _picture(scene: dict[str, Double], place: Double) -> Double:
    """Return the radiance (3, pixels) under a lamp of power 1 at a place."""
    points, normals = scene["points"], scene["normals"]
    towards = place - points
    distance = np.linalg.norm(towards, axis=1)
    towards /= distance[:, None]
    offset = points[:, None] - scene["centres"]
    along = (offset * towards[:, None]).sum(axis=-1)
    outside = (offset**2).sum(axis=-1) - scene["radii"] ** 2
    root = along**2 - outside
    blocked = (root > 0) & (np.sqrt(np.maximum(root, 0)) - along > 1e-3) & (outside > 1e-9)
    blocked[np.arange(len(points)), scene["sphere"].astype(int)] = False
    lit = ~blocked.any(axis=1)
    cosine = (normals * towards).sum(axis=1)
    halfway = _unit(towards + np.array([0, 0, 1.0]))
    highlight = np.maximum((normals * halfway).sum(axis=1), 0) ** scene["exponent"]
    highlight *= 0.5 * scene["strength"] * (cosine > 0) * lit
    wrap = scene["wrap"]
    matt = (1 - wrap) * np.maximum(cosine, 0) + wrap * np.maximum(0.6 * cosine + 0.4, 0)
    direction = _unit(place)
    ambient = 0.06 * (0.8 + 0.2 * normals @ direction)
    ambient = ambient * (0.5 + 0.5 * np.clip(direction[2] + 0.5, 0, 1))
    falloff = (np.linalg.norm(place) / distance) ** 2
    radiance: Double = (scene["colours"] * (matt * lit + ambient) + highlight) * falloff
    return radiance
