"""What pinholes see of a physically based scene, and how bright its projectors are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.mitsuba.variant import load_mitsuba
from rfpipe.mitsuba.views import Side
from rfpipe.scenes.sight import Pinhole

Double = NDArray[np.float64]


def brightness(scene: Any, projector: Side) -> float:
    """Return the flux per area of a projector's image plane at distance 1 in Mitsuba's scene.

    It is such that the full light of all projectors together gives a matt white surface that faces
    it radiance 1, or less, but for the nearest 5 % of what their pixels cover: who sets up a rig
    dims the light until its camera can take it.
    """
    areas = []
    for pinhole in projector.pinholes:
        rays = pinhole.rays()
        lengths = np.linalg.norm(rays, axis=1)
        distances, normals = hits(scene, pinhole)
        met = np.isfinite(distances)
        cosines = np.abs((rays * normals).sum(axis=1)) / lengths
        areas.append((distances**2 / lengths**3 / np.maximum(cosines, 1e-3))[met])
    covered = np.concatenate(areas)
    return float(np.pi * np.quantile(covered, 0.05)) / len(areas) if len(covered) else 1.0


def hits(scene: Any, pinhole: Pinhole) -> tuple[Double, Double]:
    """Return distances (n,), infinite where a pixel's ray meets nothing, and normals (n, 3)."""
    mi = load_mitsuba()
    start = [float(x) for x in pinhole.position]
    ways = pinhole.rays()
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(start), mi.Vector3f(ways.T)))
    return hit.t.numpy().astype(np.float64), hit.n.numpy().T.astype(np.float64)
