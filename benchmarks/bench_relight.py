"""Relighting against the speed of memory, and scipy's and numpy's products.

Usage: ``python -m benchmarks.bench_relight [--full]``; ``--full`` adds the thesis' size 310 x 350.
Writes results/bench/relight.csv, a row a size of scene IV, acquired from exact radiance, stored in
the default format and opened again. The floor is one copy, by all threads, of the factors as
float32 numbers. Times are the best of many, floors and relighting in turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numba
import numpy as np

import rfpipe
from benchmarks.harness import is_full, shortest_ms, write
from rfpipe.config import StorageConfig
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.transport import open_transport, save_transport

SIZES = ((32, 32), (64, 64), (128, 128), (155, 175))
FULL_SIZE = (310, 350)
BATCH = 16
_TIMED = ("relight", "spot", "copy", "csr", "dense")
MOST_RAYS = 64 * 64  # up to here a dense matrix of three channels is held


@numba.njit(cache=True, parallel=True)
def copy(source, target):
    parts = 64
    for part in numba.prange(parts):
        first, last = len(source) * part // parts, len(source) * (part + 1) // parts
        target[first:last] = source[first:last]


def matrix_products(transport: Any, light: np.ndarray) -> dict[str, Callable[[], object]]:
    """Return the products of a sparse and a dense matrix of the same transport."""
    from scipy.sparse import csr_array

    unit = np.eye(light.size, dtype=np.float32)
    dense = [transport.channel(channel) @ unit for channel in range(transport.channels)]
    sparse = [csr_array(matrix) for matrix in dense]
    return {
        "csr": lambda: [matrix @ light for matrix in sparse],
        "dense": lambda: [matrix @ light for matrix in dense],
    }


def measure(shape: tuple[int, int]) -> dict[str, object]:
    acquired = rfpipe.acquire(SimulatedRig(reference_scene("IV", shape)), progress=False)
    light = np.random.default_rng(0).random(shape, dtype=np.float32)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "transport.zarr"
        save_transport(acquired.transport, path, StorageConfig().number_format)
        transport = open_transport(path)
        start = time.perf_counter()
        transport.relight(light)
        first = time.perf_counter() - start
        spot = relighting_patterns(shape)["spot"].astype(np.float32)
        batch = np.random.default_rng(1).random((BATCH, *shape), dtype=np.float32)
        numbers = sum(leaves.values.size for leaves in transport.leaf_sets)
        factors = np.random.default_rng(2).random(numbers, dtype=np.float32)
        copied = np.empty_like(factors)
        small = light.size <= MOST_RAYS
        times = shortest_ms(
            copy=lambda: copy(factors, copied),
            relight=lambda: transport.relight(light),
            spot=lambda: transport.relight(spot),
            batch=lambda: transport.relight_batch(batch),
            **(matrix_products(transport, light.ravel()) if small else {}),
        )
    return {
        "size": f"{shape[0]} x {shape[1]}",
        "rays": light.size,
        "leaves": sum(len(leaves) for leaves in transport.leaf_sets),
        "store_mb": transport.nbytes / 1e6,
        "factors_mb": factors.nbytes / 1e6,
        "threads": numba.get_num_threads(),
        "first_relight_ms": 1e3 * first,
        "batch_ms_per_pattern": times["batch"] / BATCH,
        "relight_by_copy": times["relight"] / times["copy"],
        **{
            f"{name}_ms": times.get(name, "")
            for name in ("relight", "spot", "copy", "csr", "dense")
        },
    }


if __name__ == "__main__":
    write("relight", map(measure, (*SIZES, FULL_SIZE) if is_full() else SIZES))
