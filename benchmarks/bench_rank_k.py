"""Symmetric photography with and without rank-k leaves: patterns, errors and bytes.

Usage: ``python benchmarks/bench_rank_k.py [SIZE ...]``, by default 64 (pixels a side; 128
takes three minutes). Scenes II, III and IV, exact radiance and the default camera. Writes
results/bench/rank_k.csv.

``--sweep`` instead tries values of `rank_k.AMPLIFIED`, by which terms are kept, on the rooms of
rooms.py in exact radiance: those it was chosen on, and those that were set aside to judge it.
Writes results/bench/rank_k_sweep.csv (a quarter of an hour).
"""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from rooms import Ball, Box, Room, transport

import rfpipe
from rfpipe.methods.symmetric import method as symmetric
from rfpipe.methods.symmetric import rank_k as nystroem
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.scenes.base import Scene
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms

OUTPUT = Path("results/bench")

SCENES = ("II", "III", "IV")
TOLERANCES = (1e-3, 3e-4)

AMPLIFIED = (4.0, 8.0, 32.0, 128.0, np.inf)
SWEPT_TOLERANCES = (3e-3, 1e-3, 3e-4)
_BLOCK = Box((-0.45, 0.6, 3.2), (0.35, 0.5, 0.35), 25)
_BLOCKS = (
    Box((-0.5, 0.5, 3.3), (0.3, 0.6, 0.3), -20),
    Box((0.5, 0.75, 2.8), (0.3, 0.35, 0.3), 15),
)
BRED_ON: dict[str, tuple[Room, tuple[int, int]]] = {
    "block": (Room((_BLOCK,), seed=1), (32, 32)),
    "block, grain": (Room((_BLOCK,), seed=1, grain=0.01), (32, 32)),
    "gloss 30": (Room((), gloss=0.4, exponent=30, seed=2), (32, 32)),
    "gloss 12": (Room((_BLOCK,), gloss=0.6, exponent=12, seed=3), (48, 48)),
    "translucent ball": (
        Room((Ball((0.2, 0.3, 3.0), 0.6, "translucent"),), scatter=0.3, seed=4, grain=0.003),
        (32, 32),
    ),
    "mirror ball": (Room((Ball((0.2, 0.3, 3.0), 0.6, "mirror"),), seed=5), (40, 36)),
}
JUDGED_ON: dict[str, tuple[Room, tuple[int, int]]] = {
    "blocks": (Room(_BLOCKS, seed=11), (48, 48)),
    "blocks, grain": (Room(_BLOCKS, seed=11, grain=0.005), (40, 44)),
    "gloss 100": (Room((), gloss=0.3, exponent=100, seed=12), (32, 32)),
    "gloss 8": (
        Room((Ball((0.1, 0.4, 3.0), 0.5),), gloss=0.8, exponent=8, seed=13, grain=0.01),
        (32, 32),
    ),
    "translucent balls": (
        Room(
            (
                Ball((-0.4, 0.4, 3.0), 0.5, "translucent"),
                Ball((0.5, 0.2, 3.2), 0.45, "translucent"),
            ),
            scatter=0.15,
            seed=14,
        ),
        (48, 48),
    ),
    "mirror wall": (
        Room((Box((-0.3, 0.6, 3.0), (0.3, 0.5, 0.3), 30),), mirror="right", seed=15),
        (32, 32),
    ),
    "glass ball": (Room((Ball((0.1, 0.4, 2.8), 0.6, "glass"),), seed=16), (36, 36)),
}


def rank_k(wanted: bool) -> AbstractContextManager[Any]:
    """Take rank-k leaves, or none whatever the images say."""
    if wanted:
        return nullcontext()
    none = {"predictable": lambda *arguments: np.zeros_like(arguments[5])}
    return patch.multiple(symmetric, **none)


def measure(scene: Scene, noise: CameraModel | None, tolerance: float) -> dict[str, float]:
    """Acquire a scene and relight it."""
    began = time.perf_counter()
    result = rfpipe.acquire(SimulatedRig(scene, noise, seed=1), tolerance=tolerance, progress=False)
    seconds = time.perf_counter() - began
    total, unlit = [], []
    for pattern in relighting_patterns(scene.shape).values():
        truth = scene.apply(pattern.reshape(1, -1)).reshape(*scene.shape, -1)
        image = result.transport.relight(pattern)
        total.append(relative_rms(image, truth))
        if (pattern == 0).any():
            unlit.append(unlit_rms(image, truth, pattern))
    return {
        "patterns": result.patterns,
        "rank_k_leaves": int(result.levels["rank_k"].sum()),
        "total_mean": float(np.mean(total)),
        "total_worst": float(np.max(total)),
        "unlit_mean": float(np.mean(unlit)),
        "unlit_worst": float(np.max(unlit)),
        "megabytes": result.transport.nbytes / 1e6,
        "seconds": seconds,
    }


def sweep() -> None:
    """Acquire each room with each limit on a term's amplification."""
    rows = []
    for part, rooms in (("bred on", BRED_ON), ("judged on", JUDGED_ON)):
        for name, (room, shape) in rooms.items():
            matrix = transport(room, shape)
            patterns = np.stack(list(relighting_patterns(shape).values()))
            truth = patterns.reshape(len(patterns), -1) @ matrix
            rig = rfpipe.OperatorRig(matrix, shape, shape)
            for amplified in AMPLIFIED:
                for tolerance in SWEPT_TOLERANCES:
                    with patch.object(nystroem, "AMPLIFIED", amplified):
                        result = rfpipe.acquire(rig, tolerance=tolerance, progress=False)
                    images = result.transport.relight_batch(patterns).reshape(truth.shape)
                    errors = [relative_rms(*pair) for pair in zip(images, truth, strict=True)]
                    found = {
                        "patterns": result.patterns,
                        "total_mean": float(np.mean(errors)),
                        "total_worst": float(np.max(errors)),
                        "megabytes": result.transport.nbytes / 1e6,
                    }
                    run = {"rooms": part, "room": name, "amplified": amplified}
                    rows.append({**run, "tolerance": tolerance, **found})
                    print(rows[-1], flush=True)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(OUTPUT / "rank_k_sweep.csv", index=False)


def main() -> None:
    if "--sweep" in sys.argv[1:]:
        sweep()
        return
    sizes = [int(argument) for argument in sys.argv[1:]] or [64]
    rows = []
    for size in sizes:
        for which in SCENES:
            scene = reference_scene(which, (size, size), channels=1, seed=0)
            for name, noise in (("none", None), ("default", CameraModel())):
                for tolerance in TOLERANCES:
                    for wanted in (False, True):
                        run = {"size": size, "scene": which, "noise": name}
                        with rank_k(wanted):
                            found = measure(scene, noise, tolerance)
                        rows.append({**run, "tolerance": tolerance, "rank_k": wanted, **found})
                        print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    table.to_csv(OUTPUT / "rank_k.csv", index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
