"""Processing time by rays, relative to a copy of the same bytes: results/bench/scaling.csv.

Usage: ``python -m benchmarks.bench_scaling [--full]``. Scene IV in RGB through the default camera,
by symmetric and near/far acquisition in this process, at growing sizes; ``--full`` adds 310 x 350.
The floor is one pass over an image's raw bracket and its merged radiance and variance at the speed
at which this machine copies memory. Peak memory covers the whole process, simulation included.
"""

from __future__ import annotations

import multiprocessing
import resource
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from math import prod
from typing import Any

import numpy as np

import rfpipe
from benchmarks.harness import is_full, shortest_ms, write
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene

SIZES = ((32, 32), (64, 64), (128, 128))
FULL = (310, 350)
METHODS = {"symmetric": {"tolerance": 1e-3}, "near_far": {"target_error": 0.01}}
COPIED_BYTES = 2**26


def measure(method: str, shape: tuple[int, int]) -> dict[str, Any]:
    """Acquire scene IV at a size; two small acquisitions before it load and compile."""
    camera = rfpipe.CameraModel()
    for size in ((10, 12), shape):
        rig = SimulatedRig(reference_scene("IV", size), camera, 1)
        result = rfpipe.acquire(rig, method, progress=False, **METHODS[method])
    source, target = np.ones(COPIED_BYTES, np.uint8), np.zeros(COPIED_BYTES, np.uint8)
    copied = shortest_ms(0.5, copy=lambda: np.copyto(target, source))["copy"]
    raw = prod(camera.frame_shape(rig.camera_shape, 3)) * camera.frame_dtype.itemsize
    floor = copied * (raw + 2 * 4 * 3 * prod(shape)) / COPIED_BYTES
    took = 1e3 * result.processing_seconds / result.patterns
    return {
        "method": method,
        "size": f"{shape[0]} x {shape[1]}",
        "rays": prod(shape),
        "patterns": result.patterns,
        "ms_per_image": took,
        "floor_ms_per_image": floor,
        "times_the_floor": took / floor,
        "stored_mb": result.transport.nbytes / 1e6,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def rows() -> Iterator[dict[str, Any]]:
    """Measure each case in a separate process."""
    context = multiprocessing.get_context("spawn")
    sizes = (*SIZES, FULL) if is_full() else SIZES
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        for method in METHODS:
            for shape in sizes:
                yield pool.submit(measure, method, shape).result()


if __name__ == "__main__":
    write("scaling", rows())
