"""Symmetric photography with and without rank-k leaves: patterns, errors and bytes.

Usage: ``python benchmarks/bench_rank_k.py [SIZE ...]``, by default 64 (pixels a side; 128
takes three minutes). Scenes II, III and IV, exact radiance and the default camera. Writes
results/bench/rank_k.csv.
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

import rfpipe
from rfpipe.methods.symmetric import method as symmetric
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.scenes.base import Scene
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms

OUTPUT = Path("results/bench")

SCENES = ("II", "III", "IV")
TOLERANCES = (1e-3, 3e-4)


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


def main() -> None:
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
