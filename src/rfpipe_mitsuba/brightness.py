"""How strong a projector's light is."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe_mitsuba.variant import load_mitsuba
from rfpipe_mitsuba.views import Views

__all__ = ["brightness"]

_LEAST_COSINE = 1e-3
_NEAREST = 0.05


def brightness(scene: Any, projector: Views) -> float:
    """Return the flux per area of a projector's image plane at distance 1.

    It is such that the full light of all projectors together gives a matt white surface that faces
    it radiance 1, or less, but for the nearest 5 % of what their pixels cover: who sets up a rig
    dims the light until its camera can take it.

    Parameters
    ----------
    scene
        Mitsuba's scene.
    projector
        The views whose pixels are looked along, through their centres.
    """
    mi = load_mitsuba()
    height, width = projector.shape
    x = (width / 2 - np.arange(width) - 0.5) * projector.pitch
    y = (height / 2 - np.arange(height) - 0.5) * projector.pitch
    plane = np.stack([*np.meshgrid(x, y), np.ones(projector.shape)], axis=-1).reshape(-1, 3)
    areas = []
    for view in projector.views:
        lengths = np.linalg.norm(plane, axis=1)
        ways = (plane / lengths[:, None]) @ view.axes
        distances, normals = _hits(mi, scene, view.origin, ways)
        met = np.isfinite(distances)
        cosines = np.abs(np.einsum("ij,ij->i", ways, normals))[met]
        spread = (distances / lengths)[met] ** 2 / lengths[met]
        areas.append(spread / np.maximum(cosines, _LEAST_COSINE))
    found = np.concatenate(areas)
    if not len(found):
        return 1.0
    return float(np.pi * np.quantile(found, _NEAREST)) / len(projector.views)


def _hits(mi: Any, scene: Any, origin: Any, ways: Any) -> tuple[Any, Any]:
    """Return distances (n,), infinite where nothing is met, and normals (n, 3)."""
    start = [float(x) for x in origin]
    if not mi.variant().startswith("scalar"):
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(start), mi.Vector3f(ways.T)))
        return hit.t.numpy().astype(np.float64), hit.n.numpy().T.astype(np.float64)
    hits = [scene.ray_intersect(mi.Ray3f(start, [float(x) for x in way])) for way in ways]
    return np.array([hit.t for hit in hits]), np.array([list(hit.n) for hit in hits])
