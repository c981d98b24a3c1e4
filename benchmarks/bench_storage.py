"""Bytes, error and time of a stored transport, by number format and lossless codec.

Usage: ``python benchmarks/bench_storage.py [HEIGHT WIDTH]``, 124 x 140 by default. Scene IV, RGB,
with the default camera and with exact radiance at a tolerance of 1e-4. Writes
results/bench/storage.csv; `added_*` compares with the transport in memory, the largest of the
relighting patterns' errors, relative to the light; `error_*` is the same against the scene.
"""

from __future__ import annotations

import csv
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args
from unittest.mock import patch

import numpy as np

import rfpipe
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.store import arrays
from rfpipe.store.chunks import layout, small_layout
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.hierarchical.leaves import LeafSet, leaf_offsets
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.units import NumberFormat

OUTPUT = Path("results/bench/storage.csv")
# The codec that transports are stored with, and others.
CODECS: dict[str, Any] = {
    "as stored": small_layout,
    "lz4, bits shuffled": lambda _: layout("lz4"),
    "zstd 1, bits shuffled": lambda _: layout("zstd"),
    "zstd 9, bits shuffled": lambda _: layout("zstd", level=9),
    "zstd 9, bytes shuffled": lambda _: layout("zstd", level=9, shuffle="shuffle"),
}


def worst(found: np.ndarray, wanted: np.ndarray, patterns: np.ndarray) -> tuple[float, float]:
    """Return the largest relative errors of images, in total and on unlit pixels."""
    total, unlit = 0.0, 0.0
    for image, truth, pattern in zip(found, wanted, patterns, strict=True):
        difference, dark = image - truth, pattern == 0
        total = max(total, float(np.linalg.norm(difference) / np.linalg.norm(truth)))
        if dark.any():
            norm = np.linalg.norm(truth[dark])
            unlit = max(unlit, float(np.linalg.norm(difference[dark]) / norm))
    return total, unlit


def row(
    radiance: str,
    number_format: str,
    codec: str,
    mb: float,
    added: tuple[float, float],
    error: tuple[float, float],
    write_s: float,
    open_and_relight_s: float | None,
) -> dict[str, Any]:
    """Return a row of the table, and print it."""
    found = {
        "radiance": radiance,
        "number_format": number_format,
        "codec": codec,
        "mb": mb,
        "added_total": added[0],
        "added_unlit": added[1],
        "error_total": error[0],
        "error_unlit": error[1],
        "write_s": write_s,
        "open_and_relight_s": open_and_relight_s,
    }
    print(*(f"{v:.3g}" if isinstance(v, float) else v for v in found.values()))
    return found


def as_float16(transport: HierarchicalTransport) -> tuple[HierarchicalTransport, dict[str, Any]]:
    """Round factors to float16 over the largest of their leaf and channel.

    Not a format of the library: what it would store, and what it would relight with.
    """
    tree, sets, stored = transport.tree, [], {}
    for number, leaves in enumerate(transport.leaf_sets):
        lengths = np.diff(leaf_offsets(tree, leaves))
        first = np.cumsum(lengths) - lengths
        scales = np.maximum.reduceat(leaves.values, first, axis=1)
        scales[scales == 0] = 1
        spread = np.repeat(scales, lengths, axis=1)
        halves = (leaves.values / spread).astype(np.float16)
        parts = {"block_a": leaves.block_a, "block_b": leaves.block_b, "scales": scales}
        stored |= {f"{number:04d}_{name}": part for name, part in parts.items()}
        stored[f"{number:04d}_halves"] = halves
        values = halves.astype(np.float32) * spread
        sets.append(LeafSet(leaves.level, leaves.block_a, leaves.block_b, values))
    rounded = HierarchicalTransport.from_leaf_sets(tree, transport.channels, [], sets)
    return rounded, stored


def main() -> None:
    height, width = (int(word) for word in sys.argv[1:3]) if len(sys.argv) > 2 else (124, 140)
    scene = reference_scene("IV", (height, width), channels=3)
    patterns = np.stack(list(relighting_patterns(scene.shape).values()))
    truth = scene.apply(patterns).reshape(len(patterns), height, width, 3)
    rows = []
    for name, sensor, tolerance in (("camera", CameraModel(), 1e-3), ("exact", None, 1e-4)):
        rig = SimulatedRig(scene, sensor, seed=1)
        transport = rfpipe.acquire(rig, tolerance=tolerance, progress=False).transport
        assert isinstance(transport, HierarchicalTransport)
        exact = transport.relight_batch(patterns)
        # compiles the kernels, which are then cached for good
        with TemporaryDirectory() as folder:
            for number_format in get_args(NumberFormat):
                save_transport(transport, Path(folder) / number_format, number_format)
                open_transport(Path(folder) / number_format).relight_batch(patterns)
        rounded, stored = as_float16(transport)
        added = worst(rounded.relight_batch(patterns), exact, patterns)
        error = worst(rounded.relight_batch(patterns), truth, patterns)
        for codec, chosen in CODECS.items():
            with TemporaryDirectory() as folder, patch.object(arrays, "small_layout", chosen):
                path = Path(folder) / "halves.zarr"
                began = time.perf_counter()
                arrays.write_arrays(path, stored, {}, small=True)
                seconds = time.perf_counter() - began
                mb = arrays.open_arrays(path).nbytes_stored / 1e6
            rows.append(row(name, "float16 with scale", codec, mb, added, error, seconds, None))
        for number_format in get_args(NumberFormat):
            for codec, chosen in CODECS.items():
                with TemporaryDirectory() as folder, patch.object(arrays, "small_layout", chosen):
                    path = Path(folder) / "transport.zarr"
                    began = time.perf_counter()
                    save_transport(transport, path, number_format)
                    written = time.perf_counter()
                    opened_again = open_transport(path)
                    relit = opened_again.relight_batch(patterns)
                    opened = time.perf_counter()
                    added, error = worst(relit, exact, patterns), worst(relit, truth, patterns)
                    mb = opened_again.nbytes / 1e6
                rows.append(
                    row(
                        name, number_format, codec, mb, added, error, written - began,
                        opened - written,
                    )
                )  # fmt: skip
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    with OUTPUT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
