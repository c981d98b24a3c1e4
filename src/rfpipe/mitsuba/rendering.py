"""First hits of pinhole rays in a physically based scene, and the brightness of projectors."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe.array_types import Double
from rfpipe.mitsuba.variant import load_mitsuba
from rfpipe.mitsuba.views import Side
from rfpipe.scenes.pinholes import Pinhole


def brightness(scene: Any, projector: Side) -> float:
    """Compute the flux of a projector per area of its image plane at distance 1.

    With all projectors fully on, a matt white surface that faces them has radiance at most 1,
    except for the nearest 5 % of the covered area; on a real rig, the light is dimmed to the
    camera's range in the same way.
    """
    areas = []
    for pinhole in projector.pinholes:
        rays = pinhole.rays()
        lengths = np.linalg.norm(rays, axis=1)
        distances, normals = hits(scene, pinhole)
        hit = np.isfinite(distances)
        cosines = np.abs((rays * normals).sum(axis=1)) / lengths
        areas.append((distances**2 / lengths**3 / np.maximum(cosines, 1e-3))[hit])
    covered = np.concatenate(areas)
    return float(np.pi * np.quantile(covered, 0.05)) / len(areas) if len(covered) else 1.0


def hits(scene: Any, pinhole: Pinhole) -> tuple[Double, Double]:
    """Return distances (n,) along the pixels' rays, infinite without a hit, and normals (n, 3)."""
    mi = load_mitsuba()
    start = [float(x) for x in pinhole.position]
    directions = pinhole.rays()
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(start), mi.Vector3f(directions.T)))
    return hit.t.numpy().astype(np.float64), hit.n.numpy().T.astype(np.float64)
