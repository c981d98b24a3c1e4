"""Measure what the acquisition server adds to a bracket, against the same rig in this process.

Usage: ``python benchmarks/bench_server.py [HEIGHT WIDTH [EXPOSURES]]``, by default brackets of
three exposures of 310 x 350 at 16 bits, over loopback to a server process. The rig itself takes no
time: it returns a bracket that it has. Writes results/bench/server.csv: milliseconds a bracket,
the best of several rounds, and the median.
"""

from __future__ import annotations

import logging
import multiprocessing
import secrets
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import RemoteRig, Rig
from rfpipe.rigs.base import check_patterns
from rfpipe.server import ServerSettings, serve

OUTPUT = Path("results/bench")
ROUNDS = 40
BATCH = 5


class InstantRig:
    """Returns the same bracket whatever is shown, at once."""

    channels = 1
    seconds_per_pattern = 2.0

    def __init__(self, shape: tuple[int, int], exposures: int) -> None:
        self.camera_shape = self.projector_shape = shape
        times = tuple(4.0 ** (index - exposures) for index in range(exposures))
        self.sensor = CameraModel(exposures=times, bits=16)
        bracket = self.sensor.frame_shape(shape, 1)
        self._bracket = generator(0).integers(0, 2**16, bracket, np.uint16)

    def capture(self, patterns: np.ndarray, keys: Sequence[tuple[int, ...]]) -> np.ndarray:
        """Return a copy of the bracket for each pattern."""
        patterns = check_patterns(patterns, keys, self.projector_shape)
        return np.repeat(self._bracket[None], len(patterns), axis=0)

    def describe(self) -> dict[str, Any]:
        """Plain data."""
        return {"kind": "instant", "sensor": self.sensor.describe()}


def served(shape: tuple[int, int], exposures: int, port: int, token: str) -> None:
    """Run the server, without a log of each request, until it is stopped."""
    logging.disable(logging.CRITICAL)
    serve(InstantRig(shape, exposures), token, ServerSettings(port=port))


def milliseconds(rig: Rig, patterns: np.ndarray) -> list[float]:
    """Return the time of each round's capture of the patterns, a bracket."""
    keys = [(1, index) for index in range(len(patterns))]
    times = []
    for _ in range(ROUNDS):
        began = perf_counter()
        rig.capture(patterns, keys)
        times.append(1e3 * (perf_counter() - began) / len(patterns))
    return times


def shown(shape: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return five patterns of each kind: unions of blocks as a level has them, and any weights."""
    blocks = np.kron(
        generator(1).integers(0, BATCH, [-(-extent // 8) for extent in shape]),
        np.ones((8, 8), np.int64),
    )[: shape[0], : shape[1]]
    lit = blocks == np.arange(BATCH)[:, None, None]
    return {
        "blocks": lit.astype(np.float32),
        "weights": generator(2).random((BATCH, *shape), np.float32),
    }


def main() -> None:
    """Measure, print and write the table."""
    given = [int(value) for value in sys.argv[1:4]]
    height, width, exposures = (*given, *(310, 350, 3)[len(given) :])
    shape = (height, width)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    token = secrets.token_urlsafe(24)
    context = multiprocessing.get_context("spawn")
    server = context.Process(target=served, args=(shape, exposures, port, token), daemon=True)
    server.start()
    rows = []
    here = InstantRig(shape, exposures)
    logging.getLogger("rfpipe.rigs").setLevel(logging.ERROR)
    try:
        with RemoteRig(f"http://127.0.0.1:{port}", token, patience_seconds=60) as remote:
            for kind, patterns in shown(shape).items():
                for count in (1, BATCH):
                    milliseconds(remote, patterns[:count])
                    direct = milliseconds(here, patterns[:count])
                    through = milliseconds(remote, patterns[:count])
                    rows.append(
                        {
                            "height": height, "width": width, "exposures": exposures,
                            "patterns": kind, "in_a_request": count,
                            "in_process_ms": min(direct), "server_ms": min(through),
                            "added_ms": min(through) - min(direct),
                            "added_median_ms": median(through) - median(direct),
                        }
                    )  # fmt: skip
    finally:
        server.terminate()
        server.join()
    table = pd.DataFrame(rows)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    table.to_csv(OUTPUT / "server.csv", index=False)
    print(table.to_string(index=False, float_format="%.3f"))


if __name__ == "__main__":
    main()
