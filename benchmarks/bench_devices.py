"""Milliseconds of the devices that need no hardware: results/bench/devices.csv.

Usage: ``python -m benchmarks.bench_devices``. Needs a display of 1080 x 1920 pixels, such
as ``xvfb-run -s "-screen 0 1920x1080x24"`` gives it. Medians over repeats: a picture on the
projector's window, an exposure of pylon's emulated camera, a bracket of the bench; and an exposure
of each other driver on its library's virtual camera, before the bench's scene, of those installed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import write
from rfpipe.config import load_rig_config, parse_rig_config
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.build import rig_from_config
from rfpipe.rigs.cameras.pylon import PylonCamera
from rfpipe.rigs.window import WindowProjector

REPEATS = 50
DISPLAYS = (288, 320), (768, 1024), (1080, 1920)
CAMERAS = (310, 350), (1024, 1280)
DRIVERS: dict[str, tuple[dict[str, Any], dict[str, Any], int]] = {
    "pylon": ({}, {}, 1),
    "aravis": ({"pixel_format": "Mono16"}, {"bits": 16}, 1),
    "gphoto2": ({}, {"bits": 14, "bayer": "RGGB"}, 3),
    "webcam": ({}, {"bits": 8, "black_level_counts": 8}, 3),
}


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


def virtual_camera(driver: str, shape: tuple[int, int]) -> float:
    """Time an exposure of a driver before a scene that doesn't change, the making of noise too."""
    options, sensor, channels = DRIVERS[driver]
    scene = {"kind": "wedge", "surfaces": ["white", "white"], "shape": [8, 8], "channels": channels}
    settings = {
        "rays": [8, 8],
        "projector": {"options": {"settle_seconds": 0}},
        "camera": {"driver": driver, "options": options},
        "sensor": {"exposures": [0.01], **sensor},
        "bench": {"scene": scene, "display_shape": [72, 80], "camera_shape": list(shape)},
    }
    rig = rig_from_config(parse_rig_config(settings, driver))
    try:
        return median_ms(rig.camera.expose)  # type: ignore[attr-defined]
    finally:
        rig.close()  # type: ignore[attr-defined]


def rows() -> Iterator[dict[str, Any]]:
    """Yield a row a step and size."""
    os.environ["PYLON_CAMEMU"] = "1"
    steps = [("window", window, DISPLAYS), ("emulated camera", emulated_camera, CAMERAS)]
    for driver in DRIVERS:
        name = f"{driver}, before the bench's scene"
        steps.append((name, partial(virtual_camera, driver), CAMERAS))
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
