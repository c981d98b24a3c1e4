"""What a transport says that camera pixels see, against the scene's geometry and structured light.

Usage: ``python -m benchmarks.measure_places [SIDE ...]``, by default 48; a wedge of 120 degrees lit
from aside. Distances are in projector pixels, where the camera sees lit surface. Writes
results/bench/places.csv.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rfpipe
from benchmarks.harness import write
from benchmarks.methods.scenes import ASIDE, stage_of
from rfpipe.calibration.correspondence import AxisCode
from rfpipe.scenes import Scene
from rfpipe.scenes.rooms import GEOMETRIES
from rfpipe.scenes.sight import Pinhole, sight_of

_GEOMETRY = "wedge_120"
_LEAST = 0.05  # of the brightest pixel, that counts as lit


def rows(side: int) -> Iterator[dict[str, Any]]:
    """Yield a row for each way to tell places."""
    scene = stage_of("wedge_aside", str(side), 1, 1, 1, Path()).scene
    camera, lamp = Pinhole((side, side)), Pinhole((side, side), *ASIDE)
    points = sight_of(camera, GEOMETRIES[_GEOMETRY]).positions
    truth = lamp.project(points).reshape(*camera.shape, 2)
    floodlit = scene.floodlit[..., 0]
    seen = ((truth > 1) & (truth < side - 1)).all(axis=-1)
    seen &= floodlit > _LEAST * floodlit.max()

    def row(name: str, patterns: int, places: NDArray[Any], mask: NDArray[Any]) -> dict[str, Any]:
        off = np.linalg.norm(places - truth, axis=-1)[mask & seen]
        return {"by": name, "side": side, "pixels": int(seen.sum()), "told": len(off),
                "patterns": patterns, "median": float(np.median(off)),
                "nine tenths": float(np.quantile(off, 0.9)), "beyond 1": int((off > 1).sum())
                }  # fmt: skip

    yield row("structured light", *_structured(scene, camera, lamp))
    for method, noise in (("brute_force", None), ("auto", rfpipe.CameraModel())):
        rig = rfpipe.OperatorRig(scene, camera.shape, lamp.shape, noise, seed=1)
        result = rfpipe.acquire(rig, method, progress=False)
        found = result.transport.correspondence()
        yield row(method, result.patterns, found.places, found.mask)


def _structured(
    scene: Scene, camera: Pinhole, lamp: Pinhole
) -> tuple[int, NDArray[Any], NDArray[Any]]:
    """Decode Gray code and sinusoids in exact pictures."""
    coordinates, valid, count = [], np.ones(camera.shape, np.bool_), 0
    for axis in (0, 1):
        code = AxisCode(lamp.shape[axis])
        lines = np.stack(code.lines())
        count += len(lines)
        along = lines[:, :, None] if axis == 0 else lines[:, None]
        patterns = np.broadcast_to(along, (len(lines), *lamp.shape)).reshape(len(lines), -1)
        images = scene.apply(patterns).reshape(len(lines), *camera.shape).astype(np.float64)
        found = code.decode(images, np.full_like(images, 1e-12))
        coordinates.append(found["coordinate"])
        valid &= found["valid"]
    return count, np.stack(coordinates, axis=-1), valid


if __name__ == "__main__":
    write("places", (r for side in sys.argv[1:] or ["48"] for r in rows(int(side))))
