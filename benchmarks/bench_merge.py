"""Measure merge and normalize on files: one by one, by threads, and on a local dask cluster.

Usage: ``python benchmarks/bench_merge.py [HEIGHT WIDTH [PATTERNS]]``, by default 310 x 350 RGB and
240 patterns. Writes results/bench/merge.csv: milliseconds an HDR image, beside the floor, a copy
of the same bytes in memory.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

from rfpipe.patterns import Schedule
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig
from rfpipe.stages import capture, merge, normalize
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.stages.results import write_bundle
from rfpipe.store import FrameStore

OUTPUT = Path("results/bench")
REPEATS = 3


class Textured:
    """A textured surface that spreads a little of its light evenly."""

    channels = 3

    def __init__(self, rays: int) -> None:
        self._albedo = np.where(generator(0).random((rays, 3)) < 0.5, 0.15, 0.85)

    def apply(self, patterns: np.ndarray) -> np.ndarray:
        """Return the images (B, rays, 3) of patterns (B, rays)."""
        light = patterns[:, :, None] + 0.1 * patterns.mean(axis=1)[:, None, None]
        return np.asarray(light * self._albedo)


def captured(folder: AcquisitionFolder, shape: tuple[int, int], patterns: int) -> OperatorRig:
    """Capture level 0 and a level of random patterns."""
    rig = OperatorRig(Textured(shape[0] * shape[1]), shape, shape, CameraModel(), threads=2)
    for level, count in enumerate((1, patterns)):
        lit = generator(1, level).integers(0, count, shape).astype(np.int32)
        shown = Schedule(level, shape, count, lit, complete=True).digest()
        facts = {"patterns": count, "complete": True, "shape": shape, "shown": shown}
        manifest = folder.manifest(level, "schedule")
        write_bundle(manifest, "by hand", {"pattern_of_ray": lit}, facts)
        capture.run(rig, folder, level, references=(8, 64))
        run_merge(rig, folder, level, Resources())
    return rig


def run_merge(
    rig: OperatorRig, folder: AcquisitionFolder, level: int, resources: Resources
) -> float:
    """Merge and normalize a level anew; return the seconds."""
    FrameStore.discard(folder.store(level, "merge"))
    plan = Plan("brute_force", "brute_force", rig.camera_shape, rig.projector_shape, rig.channels)
    began = perf_counter()
    merge.run(
        folder,
        level,
        saturation_fraction=0.98,
        mask_defects=True,
        code="",
        resources=resources,
    )
    normalize.run(plan, folder, level, mode="per_channel", code=str(began))
    return perf_counter() - began


def main() -> None:
    """Measure, print and write the table."""
    from distributed import LocalCluster

    height, width, patterns = (int(value) for value in (*sys.argv[1:4], 310, 350, 240)[:3])
    cores = os.cpu_count() or 1
    with (
        tempfile.TemporaryDirectory() as place,
        LocalCluster(cores, threads_per_worker=1, dashboard_address=":0") as cluster,
    ):
        folder = AcquisitionFolder(Path(place))
        rig = captured(folder, (height, width), patterns)
        ways = {
            "one by one": Resources(),
            f"{cores} threads": Resources(threads=cores),
            f"dask, {cores} workers": Resources(where=cluster.scheduler_address),
        }
        seconds = dict.fromkeys([*ways, "floor"], np.inf)
        # brackets and their merge: four times 2 bytes, twice 4 bytes a sample; beyond any cache
        many = np.ones((64, 2 * height * width * 3 * 8), np.uint8)
        copied = many.copy()
        for _ in range(REPEATS):
            for name, resources in ways.items():
                seconds[name] = min(seconds[name], run_merge(rig, folder, 1, resources) / patterns)
            began = perf_counter()
            np.copyto(copied, many)
            seconds["floor"] = min(seconds["floor"], (perf_counter() - began) / len(many))
    table = pd.DataFrame(
        [
            {"height": height, "width": width, "patterns": patterns, "how": name, "ms": 1e3 * value}
            for name, value in seconds.items()
        ]
    )
    OUTPUT.mkdir(parents=True, exist_ok=True)
    table.to_csv(OUTPUT / "merge.csv", index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
