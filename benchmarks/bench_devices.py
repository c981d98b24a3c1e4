"""Milliseconds of the devices that need no hardware: results/bench/devices.csv.

Usage: ``python -m benchmarks.bench_devices``. Needs a display of 1080 x 1920 pixels, such
as ``xvfb-run -s "-screen 0 1920x1080x24"`` gives it. Medians over repeats: a picture on the
projector's window, an exposure of pylon's emulated camera, a bracket of the bench.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.harness import write
from rfpipe.config import load_rig_config
from rfpipe.devices.pylon import PylonCamera
from rfpipe.devices.window import WindowProjector
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.build import rig_from_config

REPEATS = 50
DISPLAYS = (288, 320), (768, 1024), (1080, 1920)
CAMERAS = (310, 350), (1024, 1280)


def median_ms(step: Callable[[], object]) -> float:
    step()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        step()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def window(shape: tuple[int, int]) -> float:
    picture = np.random.default_rng(0).random(shape, np.float32)
    with WindowProjector(shape=shape, settle_seconds=0) as projector:
        return median_ms(lambda: projector.show(picture))


def emulated_camera(shape: tuple[int, int]) -> float:
    with PylonCamera(CameraModel(exposures=(0.01,)), shape=shape) as camera:
        return median_ms(camera.expose)


def bench() -> float:
    config = load_rig_config("config/bench.yaml").model_copy(update={"rays": (32, 32)})
    rig = rig_from_config(config)
    pattern = np.random.default_rng(0).random((1, 32, 32)).astype(np.float32)
    lights = iter(np.linspace(0, 1, REPEATS + 1, dtype=np.float32))
    try:
        return median_ms(lambda: rig.capture(pattern * next(lights), [(0, 0)]))
    finally:
        rig.close()  # type: ignore[attr-defined]


def rows() -> Iterator[dict[str, Any]]:
    """Yield a row a step and size."""
    os.environ["PYLON_CAMEMU"] = "1"
    steps = [("window", window, DISPLAYS), ("emulated camera", emulated_camera, CAMERAS)]
    for name, measure, shapes in steps:
        try:
            for shape in shapes:
                size = f"{shape[0]} x {shape[1]}"
                yield {"step": name, "pixels": size, "ms": measure(shape)}
        except CaptureError as error:
            print(f"{name} left out: {error}")
    yield {"step": "bench, 32 x 32 rays, four exposures", "pixels": "72 x 80", "ms": bench()}


if __name__ == "__main__":
    write("devices", rows())
