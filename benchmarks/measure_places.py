"""Projector places of camera pixels by a transport, by geometry and by structured light.

Usage: ``python -m benchmarks.measure_places [SIDE ...]``, by default 48; a wedge of 120 degrees lit
from aside. Distances are in projector pixels, errors of depth in parts of it, where the camera sees
lit surface; with the noise of the default camera. Writes results/bench/places.csv.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import rfpipe
from benchmarks.harness import given, write
from benchmarks.methods.scenes import ASIDE, stage_of
from rfpipe.calibration.correspondence import AxisCode
from rfpipe.rigs import Rig
from rfpipe.scenes.pinholes import Pinhole, first_hits
from rfpipe.scenes.rooms import GEOMETRIES

_GEOMETRY = "wedge_120"
_LEAST = 0.05  # of the brightest pixel, that counts as lit


def rows(side: int) -> Iterator[dict[str, Any]]:
    """Yield a row for each way to compute places."""
    scene = stage_of("wedge_aside", str(side), 1, 1, 1, Path()).scene
    camera, lamp = Pinhole((side, side)), Pinhole((side, side), *ASIDE)
    points = first_hits(camera, GEOMETRIES[_GEOMETRY]).positions
    truth = lamp.project(points).reshape(*camera.shape, 2)
    floodlit = scene.floodlit[..., 0]
    visible = ((truth > 1) & (truth < side - 1)).all(axis=-1)
    visible &= floodlit > _LEAST * floodlit.max()

    def row(name: str, patterns: int, places: NDArray[Any], mask: NDArray[Any]) -> dict[str, Any]:
        judged = mask & visible
        off = np.linalg.norm(places - truth, axis=-1)[judged]
        sides = (
            (np.argwhere(judged)[:, ::-1].T + 0.5),
            places[judged][:, ::-1].T.astype(np.float64),
        )
        point = cv2.triangulatePoints(camera.matrix, lamp.matrix, *sides)
        deep = np.abs(point[2] / point[3] / points.reshape(*camera.shape, 3)[judged, 2] - 1)
        return {"by": name, "side": side, "pixels": int(visible.sum()), "told": len(off),
                "patterns": patterns, "median": float(np.median(off)),
                "nine tenths": float(np.quantile(off, 0.9)), "beyond 1": int((off > 1).sum()),
                "depth": float(np.median(deep)), "depth, nine tenths": float(np.quantile(deep, 0.9))
                }  # fmt: skip

    for noise in (None, rfpipe.CameraModel()):
        rig = rfpipe.OperatorRig(scene, camera.shape, lamp.shape, noise, seed=1)
        name = f"structured light, {'noise' if noise else 'exact'}"
        yield row(name, *_structured(rig))
    for method, noise in (("brute_force", None), ("auto", rfpipe.CameraModel())):
        rig = rfpipe.OperatorRig(scene, camera.shape, lamp.shape, noise, seed=1)
        result = rfpipe.acquire(rig, method, progress=False)
        matches = result.transport.correspondence()
        yield row(method, result.patterns, matches.places, matches.mask)


def _structured(rig: Rig) -> tuple[int, NDArray[Any], NDArray[Any]]:
    """Show Gray code and sinusoids, a bracket each, and decode them."""
    shape = rig.projector_shape
    dark = rig.capture(np.zeros((8, *shape), np.float32), [(0, index) for index in range(8)])
    coordinates, valid, count = [], np.ones(rig.camera_shape, np.bool_), 0
    for axis in (0, 1):
        code = AxisCode(shape[axis])
        lines = np.stack(code.lines())
        count += len(lines)
        along = lines[:, :, None] if axis == 0 else lines[:, None]
        patterns = np.broadcast_to(along, (len(lines), *shape))
        frames = rig.capture(patterns, [(1, axis, index) for index in range(len(lines))])
        merged = rig.sensor.merge(frames, dark.mean(axis=0, dtype=np.float32), len(dark))
        images = (merged.radiance, np.maximum(merged.variance, 1e-12))
        matches = code.decode(*(it[..., 0].astype(np.float64) for it in images))
        coordinates.append(matches["coordinate"])
        valid &= matches["valid"]
    return count, np.stack(coordinates, axis=-1), valid


if __name__ == "__main__":
    write("places", (r for side in given("side", int, [48]) for r in rows(side)))
