"""Light fields by footprints, symmetric and dual photography: patterns against errors.

Usage: ``python -m benchmarks.bench_light_field [HEIGHTxWIDTH ...] [--methods M ...]
[--targets T ...] [--seed S]``. A room seen by three by three views of each size, default camera,
grey; 12 x 16 and 24 x 32 take ten minutes. Writes results/bench/light_field.csv: patterns, the
estimated error, the mean and the largest error of the scene's relighting patterns, of a spot of 12
pixels in one view and of spots in all of them, and seconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rfpipe
from benchmarks.harness import errors, image_size, write
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.relighting import octave_noise
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import relighting_patterns, room_scene
from rfpipe.stages.relight import images_of

_VIEWS = (3, 3)


def main() -> None:
    """Acquire every field by every method to every target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs="*", default=["12x16", "24x32"], metavar="HEIGHTxWIDTH")
    parser.add_argument("--methods", nargs="+", default=["footprints", "symmetric", "dual"])
    parser.add_argument("--targets", nargs="+", type=float, default=[0.02, 0.01])
    parser.add_argument("--seed", type=int, default=1, help="of the camera's noise")
    arguments = parser.parse_args()
    print(write("light_field", rows(arguments)).round(2).to_string(index=False))


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield a row a size, method and target."""
    for size in arguments.sizes:
        shape = image_size(size)
        scene = room_scene(("texture", "white", "white"), shape, views=_VIEWS, channels=1)
        for method, target in product(arguments.methods, arguments.targets):
            yield {"size": size, **acquired(scene, method, target, arguments.seed)}


def acquired(scene: Any, method: str, target: float, seed: int) -> dict[str, Any]:
    """Acquire a scene, and relight it."""
    begun = time.perf_counter()
    rig = SimulatedRig(scene, CameraModel(), seed=seed)
    # mean errors are some three tolerances of a hierarchy
    options = {"target_error": target} if method == "footprints" else {"tolerance": 0.3 * target}
    result = rfpipe.acquire(rig, method=method, progress=False, **options)
    seconds = time.perf_counter() - begun
    shown = {**relighting_patterns(scene.shape), **spots_of(scene.shape)}
    light = np.stack(list(shown.values()))
    relative = errors(result.transport.relight_batch(light), images_of(scene, light))
    errors_by_kind = dict(zip(shown, 100 * relative, strict=True))
    usual = [errors_by_kind[name] for name in relighting_patterns(scene.shape)]
    return {
        "method": method,
        "target": target,
        "patterns": result.patterns,
        "estimate": 100 * float(result.history["estimated_error"].max()),
        "mean": float(np.mean(usual)),
        "largest": max(usual),
        "spot": errors_by_kind["spot of 12"],
        "spots": errors_by_kind["spots"],
        "noise in one view": errors_by_kind["noise in one view"],
        "seconds": seconds,
    }


def spots_of(shape: tuple[int, ...]) -> dict[str, NDArray[np.float32]]:
    """Return a spot of 12 pixels in the middle view, spots in all views, and noise in one."""
    views, height, width = shape
    single, several, noise = (np.zeros(shape, np.float32) for _ in range(3))
    single[views // 2, height // 3 :, width // 3 :][:3, :4] = 1
    random = generator(0, views, height, width)
    for view in range(views):
        for _ in range(4):
            top, column = random.integers(0, height - 3), random.integers(0, width - 3)
            several[view, top : top + 3, column : column + 3] = 1
    noise[min(2, views - 1)] = octave_noise((height, width), random, 0.0) > 0
    return {"spot of 12": single, "spots": several, "noise in one view": noise}


if __name__ == "__main__":
    main()
