"""Symmetric photography with and without rank-k leaves: patterns, errors and bytes.

Usage: ``python -m benchmarks.bench_rank_k [SIZE ...]``, by default 64 (pixels a side; 128
takes three minutes). Scenes II, III and IV, exact radiance and the default camera. Writes
results/bench/rank_k.csv.

``--sweep`` instead tries values of `rank_test.AMPLIFIED`, by which terms are kept, on the rooms of
rooms.py in exact radiance: those it was chosen on, and those that were set aside to judge it.
Writes results/bench/rank_k_sweep.csv (a quarter of an hour).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from itertools import product
from typing import Any
from unittest.mock import patch

import numpy as np

import rfpipe
from benchmarks.harness import errors, write
from benchmarks.rooms import Ball, Box, Room, transport
from rfpipe.methods.symmetric import method as symmetric
from rfpipe.methods.symmetric import rank_test as nystroem
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.scenes.base import Scene

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
    none = {"predictable": lambda _divided, asked, _limits: np.zeros_like(asked)}
    return patch.multiple(symmetric, **none)


def measure(scene: Scene, noise: CameraModel | None, tolerance: float) -> dict[str, float]:
    """Acquire a scene and relight it."""
    began = time.perf_counter()
    result = rfpipe.acquire(SimulatedRig(scene, noise, seed=1), tolerance=tolerance, progress=False)
    seconds = time.perf_counter() - began
    patterns = np.stack(list(relighting_patterns(scene.shape).values()))
    images = result.transport.relight_batch(patterns)
    truth = scene.apply(patterns.reshape(len(patterns), -1)).reshape(images.shape)
    dark = (patterns == 0)[..., None]
    total, unlit = errors(images, truth), errors(images * dark, truth * dark)
    return {
        "patterns": result.patterns,
        "rank_k_leaves": int(result.levels["rank_k"].sum()),
        "total_mean": total.mean(),
        "total_worst": total.max(),
        "unlit_mean": np.nanmean(unlit),
        "unlit_worst": np.nanmax(unlit),
        "megabytes": result.transport.nbytes / 1e6,
        "seconds": seconds,
    }


def sweep() -> Iterator[dict[str, Any]]:
    """Acquire each room with each limit on a term's amplification."""
    for part, rooms in (("bred on", BRED_ON), ("judged on", JUDGED_ON)):
        for name, (room, shape) in rooms.items():
            matrix = transport(room, shape)
            patterns = np.stack(list(relighting_patterns(shape).values()))
            truth = patterns.reshape(len(patterns), -1) @ matrix
            rig = rfpipe.OperatorRig(matrix, shape, shape)
            for amplified, tolerance in product(AMPLIFIED, SWEPT_TOLERANCES):
                with patch.object(nystroem, "AMPLIFIED", amplified):
                    result = rfpipe.acquire(rig, tolerance=tolerance, progress=False)
                off = errors(result.transport.relight_batch(patterns), truth)
                yield {
                    "rooms": part, "room": name, "amplified": amplified, "tolerance": tolerance,
                    "patterns": result.patterns, "total_mean": off.mean(), "total_worst": off.max(),
                    "megabytes": result.transport.nbytes / 1e6,
                }  # fmt: skip


def compared(sizes: list[int]) -> Iterator[dict[str, Any]]:
    """Acquire each scene with and without rank-k leaves."""
    for size, which in product(sizes, SCENES):
        scene = reference_scene(which, (size, size), channels=1, seed=0)
        cameras = (("none", None), ("default", CameraModel()))
        for (name, noise), tolerance, wanted in product(cameras, TOLERANCES, (False, True)):
            with rank_k(wanted):
                found = measure(scene, noise, tolerance)
            run = {"size": size, "scene": which, "noise": name}
            yield {**run, "tolerance": tolerance, "rank_k": wanted, **found}


if __name__ == "__main__":
    if "--sweep" in sys.argv[1:]:
        write("rank_k_sweep", sweep())
    else:
        write("rank_k", compared([int(argument) for argument in sys.argv[1:]] or [64]))
