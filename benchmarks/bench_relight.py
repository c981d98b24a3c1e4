"""Time relighting against the speed of memory, and against scipy's and numpy's products.

Usage: ``python benchmarks/bench_relight.py [--full]``; ``--full`` adds the thesis' size 310 x 350.
Writes results/bench/relight.csv, one row a size of scene IV, acquired from exact radiance, stored
in the default format and opened again.

The floor is one copy, by all threads, of the factors as float32 numbers; an opened transport holds
codes of 8 bits, whose copy is timed as well, and the reading of the numbers. Times are
the best of many, floors and relighting in turn.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np

import rfpipe
from rfpipe.config import StorageConfig
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.store import open_arrays
from rfpipe.transport import open_transport, save_transport

OUTPUT = Path("results/bench/relight.csv")
SIZES = ((32, 32), (64, 64), (128, 128), (155, 175))
FULL_SIZE = (310, 350)
BATCH = 16
# A dense matrix of three channels is held up to here.
MOST_RAYS = 64 * 64
SECONDS = 4.0
IN_A_ROW = 3


@numba.njit(cache=True, parallel=True)
def copy(source, target):
    parts = 64
    for part in numba.prange(parts):
        first, last = len(source) * part // parts, len(source) * (part + 1) // parts
        target[first:last] = source[first:last]


@numba.njit(cache=True, parallel=True, fastmath=True)
def read(source):
    parts = 64
    sums = np.zeros(parts, np.float32)
    for part in numba.prange(parts):
        values = source[len(source) * part // parts : len(source) * (part + 1) // parts]
        total = np.float32(0)
        for n in range(len(values)):
            total += values[n]
        sums[part] = total
    return sums.sum()


def best(**actions: Callable[[], object]) -> dict[str, float]:
    """Return the shortest time of each action in ms, warm; all of them in turn for `SECONDS`."""
    for action in actions.values():
        action()  # compiles, or loads what was compiled
    shortest = dict.fromkeys(actions, np.inf)
    began = time.perf_counter()
    while time.perf_counter() - began < SECONDS:
        for name, action in actions.items():
            for _ in range(IN_A_ROW):
                start = time.perf_counter()
                action()
                shortest[name] = min(shortest[name], time.perf_counter() - start)
    return {name: 1e3 * seconds for name, seconds in shortest.items()}


def matrix_products(transport, pattern) -> tuple[dict[str, float], dict[str, Callable[[], object]]]:
    """Return the MB of a sparse and a dense matrix of the same transport, and their products."""
    from scipy.sparse import csr_array

    rays = pattern.size
    light = pattern.reshape(-1)
    channels = []
    for channel in range(transport.channels):
        impulses = np.eye(rays, dtype=np.float32)
        columns = [
            transport.channel(channel) @ impulses[:, first : first + 256]
            for first in range(0, rays, 256)
        ]
        channels.append(np.ascontiguousarray(np.concatenate(columns, axis=1)))
    sparse = [csr_array(matrix) for matrix in channels]
    stored = [part for m in sparse for part in (m.data, m.indices, m.indptr)]
    sizes = {
        "csr_mb": sum(part.nbytes for part in stored) / 1e6,
        "dense_mb": sum(matrix.nbytes for matrix in channels) / 1e6,
    }
    actions = {
        "csr": lambda: [matrix @ light for matrix in sparse],
        "dense": lambda: [matrix @ light for matrix in channels],
    }
    return sizes, actions


def measure(shape: tuple[int, int]) -> dict[str, object]:
    scene = reference_scene("IV", shape, channels=3)
    acquired = rfpipe.acquire(SimulatedRig(scene), progress=False)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "transport.zarr"
        save_transport(acquired.transport, path, StorageConfig().number_format)
        transport = open_transport(path)
        start = time.perf_counter()
        dense_light = np.random.default_rng(0).random(shape, dtype=np.float32)
        transport.relight(dense_light)
        first = time.perf_counter() - start
        stored = open_arrays(path)
        names = [name for name in stored.names if name.endswith(("_codes", "_values"))]
        held = sum(prod(stored.shape(name)) * stored.dtype(name).itemsize for name in names)
    spot = relighting_patterns(shape)["spot"].astype(np.float32)
    batch = np.random.default_rng(1).random((BATCH, *shape), dtype=np.float32)
    leaf_sets = transport.leaf_sets
    numbers = sum(leaves.values.size for leaves in leaf_sets)
    factors = np.random.default_rng(2).random(numbers, dtype=np.float32)
    codes = factors.view(np.uint8)[:held]
    small = dense_light.size <= MOST_RAYS
    sizes, products = matrix_products(transport, dense_light) if small else ({}, {})
    copied = np.empty_like(factors)
    times = best(
        copy=lambda: copy(factors, copied),
        read=lambda: read(factors),
        copy_held=lambda: copy(codes, copied.view(np.uint8)),
        relight=lambda: transport.relight(dense_light),
        spot=lambda: transport.relight(spot),
        batch=lambda: transport.relight_batch(batch),
        **products,
    )
    return {
        "height": shape[0],
        "width": shape[1],
        "rays": dense_light.size,
        "patterns": acquired.patterns,
        "leaves": sum(len(leaves) for leaves in leaf_sets),
        "store_mb": transport.nbytes / 1e6,
        "factors_mb": factors.nbytes / 1e6,
        "held_mb": held / 1e6,
        "threads": numba.get_num_threads(),
        "first_relight_ms": 1e3 * first,
        "relight_ms": times["relight"],
        "spot_ms": times["spot"],
        "batch_ms_per_pattern": times["batch"] / BATCH,
        "copy_ms": times["copy"],
        "read_ms": times["read"],
        "copy_held_ms": times["copy_held"],
        "relight_by_copy": times["relight"] / times["copy"],
        "relight_by_copy_held": times["relight"] / times["copy_held"],
        "csr_mb": sizes.get("csr_mb", ""),
        "csr_ms": times.get("csr", ""),
        "dense_mb": sizes.get("dense_mb", ""),
        "dense_ms": times.get("dense", ""),
    }


def main() -> None:
    sizes = (*SIZES, FULL_SIZE) if "--full" in sys.argv[1:] else SIZES
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    with OUTPUT.open("w", newline="") as file:
        writer = None
        for shape in sizes:
            row = measure(shape)
            row = {k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}
            writer = writer or csv.DictWriter(file, list(row))
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            print(row, flush=True)


if __name__ == "__main__":
    main()
