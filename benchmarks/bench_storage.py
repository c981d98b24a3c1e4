"""Bytes, error and time of a stored transport, by number format and lossless codec.

Usage: ``python -m benchmarks.bench_storage [HEIGHT WIDTH]``, 124 x 140 by default. Scene IV, RGB,
with the default camera and with exact radiance at a tolerance of 1e-4. Writes
results/bench/storage.csv; `added` compares with the transport in memory, the largest of the
relighting patterns' errors; `error` is the same against the scene.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args
from unittest.mock import patch

import numpy as np

import rfpipe
from benchmarks.harness import errors, given, write
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.store import arrays
from rfpipe.store.chunks import layout, small_layout
from rfpipe.transport import open_transport, save_transport
from rfpipe.units import NumberFormat

# The codec that transports are stored with, and others.
CODECS: dict[str, Any] = {
    "as stored": small_layout,
    "lz4, bits shuffled": lambda _: layout("lz4"),
    "zstd 1, bits shuffled": lambda _: layout("zstd"),
    "zstd 9, bits shuffled": lambda _: layout("zstd", level=9),
    "zstd 9, bytes shuffled": lambda _: layout("zstd", level=9, shuffle="shuffle"),
}


def rows(shape: tuple[int, int]) -> Iterator[dict[str, Any]]:
    """Acquire the scene, and store it by each format and codec."""
    scene = reference_scene("IV", shape, channels=3)
    patterns = np.stack(list(relighting_patterns(scene.shape).values()))
    truth = scene.apply(patterns).reshape(len(patterns), *shape, 3)
    for name, sensor, tolerance in (("camera", rfpipe.CameraModel(), 1e-3), ("exact", None, 1e-4)):
        rig = SimulatedRig(scene, sensor, seed=1)
        transport = rfpipe.acquire(rig, tolerance=tolerance, progress=False).transport
        exact = transport.relight_batch(patterns)
        for number_format in get_args(NumberFormat):
            for codec, chosen in CODECS.items():
                with TemporaryDirectory() as folder, patch.object(arrays, "small_layout", chosen):
                    path = Path(folder) / "transport.zarr"
                    began = time.perf_counter()
                    save_transport(transport, path, number_format)
                    written = time.perf_counter()
                    opened = open_transport(path)
                    relit = opened.relight_batch(patterns)
                    yield {
                        "radiance": name, "number_format": number_format, "codec": codec,
                        "mb": opened.nbytes / 1e6,
                        "added": np.nanmax(errors(relit, exact)),
                        "error": np.nanmax(errors(relit, truth)),
                        "write_s": written - began,
                        "open_and_relight_s": time.perf_counter() - written,
                    }  # fmt: skip


if __name__ == "__main__":
    height, width, *_ = [*given("side", int, (124, 140)), 140]
    write("storage", rows((height, width)))
