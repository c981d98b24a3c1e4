"""Time, memory and accuracy of simulated scenes, into results/bench/scene_apply.csv.

Errors are those of the form factors against exact rows, the worst of 64 rows under light from
everywhere and from a spot of 12 pixels.
"""

from __future__ import annotations

import csv
import resource
import time
from pathlib import Path

import numpy as np

from rfpipe.scenes import RadiosityScene, planes_scene
from rfpipe.scenes.facing import facing_pairs
from rfpipe.scenes.hard import PLATE

OUTPUT = Path("results/bench/scene_apply.csv")

# Smallest first: the peak of memory is that of the process so far.
CASES = (
    ((62, 70), 3, ()),
    ((128, 128), 3, ()),
    ((310, 350), 1, ()),
    ((310, 350), 3, ()),
    ((310, 350), 3, (PLATE,)),
)
PATTERNS = 16


def error_of(scene: RadiosityScene) -> float:
    (pair,) = facing_pairs(scene.points, scene.occluders)
    random = np.random.default_rng(0)
    rows = random.choice(len(pair.indices[0]), 64, replace=False)
    columns = np.zeros((len(scene.points.surface), 2))
    columns[:, 0] = random.random(len(columns))
    columns[random.choice(pair.indices[1], 12), 1] = 1
    exact = pair.block(rows) @ columns[pair.indices[1]]
    error = np.abs(scene.form_factors.apply(columns)[pair.indices[0][rows]] - exact)
    return float((error[exact > 0] / exact[exact > 0]).max())


def measure(shape, channels, occluders) -> dict[str, object]:
    scene = planes_scene(
        "wedge", ("texture", "texture"), shape, channels=channels, occluders=occluders
    )
    start = time.perf_counter()
    stored = scene.form_factors.nbytes
    build = time.perf_counter() - start
    patterns = np.random.default_rng(1).random((PATTERNS, *shape), dtype=np.float32)
    seconds = []
    for _ in range(3):  # the first one also loads or compiles the kernels
        start = time.perf_counter()
        scene.apply(patterns)
        seconds.append(time.perf_counter() - start)
    return {
        "height": shape[0],
        "width": shape[1],
        "channels": channels,
        "occluders": len(occluders),
        "build_s": round(build, 2),
        "stored_mb": round(stored / 1e6, 1),
        "apply_ms_per_pattern": round(min(seconds) / PATTERNS * 1e3, 2),
        "worst_relative_error": f"{error_of(scene):.1e}",
        "peak_gib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }


def main() -> None:
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    with OUTPUT.open("w", newline="") as file:
        writer = None
        for case in CASES:
            row = measure(*case)
            writer = writer or csv.DictWriter(file, list(row))
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            print(row, flush=True)


if __name__ == "__main__":
    main()
