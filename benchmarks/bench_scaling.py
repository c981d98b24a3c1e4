"""How processing grows with the rays, beside a copy of the same bytes: results/bench/scaling.csv.

Usage: ``python benchmarks/bench_scaling.py [--full]``. Scene IV of config/thesis.yaml in RGB at
growing sizes and its light field at 26 x 40 rays a view are acquired by symmetric photography,
stage by stage on files as the workflow does, in one process on all cores. ``--full`` goes on to the
thesis' own sizes, which takes a quarter of an hour or more, most of it simulation.

Processing is all but the time inside the simulated rig: schedule, storing the raw brackets, merge,
normalize, refine, assemble. The floor is one pass, read and write, over a level's raw brackets and
its merged radiance and variance, at the speed at which all cores together copy memory. The peak of
memory is that of the whole process, the simulated scene in it.
"""

from __future__ import annotations

import argparse
import csv
import logging
import multiprocessing
import os
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

OUTPUT = Path("results/bench/scaling.csv")
THESIS = Path(__file__).parents[1] / "config" / "thesis.yaml"

# Scene, shape of a view, how often it is measured; the fastest counts.
CASES = (
    ("planes_iv", (32, 32), 3),
    ("planes_iv", (64, 64), 3),
    ("planes_iv", (128, 128), 2),
    ("light_field", (26, 40), 1),
)
FULL_CASES = (("planes_iv", (310, 350), 1), ("light_field", (130, 200), 1))
SMALL = (10, 12)

PROCESSING = ("schedule", "store", "merge", "normalize", "refine", "assemble")
COPIED_BYTES = 2**28
COPIES = 8


def main() -> None:
    """Measure each case in a process of its own."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--full", action="store_true", help="the thesis' own sizes, too")
    cases = CASES + (FULL_CASES if parser.parse_args().full else ())
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    with (
        OUTPUT.open("w", newline="") as file,
        ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool,
    ):
        writer = None
        for case in cases:
            before = copy_bytes_per_second()
            found = pool.submit(measure, *case).result()
            row = beside_the_floor(found, max(before, copy_bytes_per_second()))
            writer = writer or csv.DictWriter(file, list(row))
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            print(row, flush=True)


def measure(name: str, shape: tuple[int, int], repeats: int) -> dict[str, Any]:
    """Acquire a scene of the thesis at some size; return the fastest run, see `acquire`."""
    from rfpipe.config import load_config

    logging.getLogger("rfpipe").setLevel(logging.ERROR)
    config = load_config(THESIS)
    acquire(config, name, SMALL)  # load the libraries, compile the kernels
    runs = [acquire(config, name, shape) for _ in range(repeats)]
    peak = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert peak is not None
    best = min(runs, key=lambda run: sum(run[stage] for stage in PROCESSING))
    views = prod(config.scenes[name].views or (1,))
    return {
        "scene": name,
        "views": views,
        "height": shape[0],
        "width": shape[1],
        "rays": views * prod(shape),
        "tolerance": config.methods_of(name)["symmetric"].options()["tolerance"],
        "peak": 1024 * int(peak[1]),
        **best,
    }


def beside_the_floor(found: dict[str, Any], copied: float) -> dict[str, object]:
    """Return a row of the table: seconds an image beside those of a copy."""
    patterns = found["patterns"]
    processing = sum(found[stage] for stage in PROCESSING) / patterns
    floor = found["bytes_per_image"] / copied
    about = ("scene", "views", "height", "width", "rays", "tolerance", "patterns")
    return {
        **{name: found[name] for name in about},
        "processing_s_per_image": f"{processing:.4g}",
        "floor_s_per_image": f"{floor:.4g}",
        "ratio": f"{processing / floor:.3g}",
        **{f"{stage}_s_per_image": f"{found[stage] / patterns:.3g}" for stage in PROCESSING},
        "simulation_s_per_image": f"{found['simulation'] / patterns:.3g}",
        "stored_mb": f"{found['stored'] / 1e6:.4g}",
        "peak_mb": f"{found['peak'] / 1e6:.0f}",
    }


def copy_bytes_per_second() -> float:
    """Return how many bytes all cores together read and write elsewhere in a second."""
    import numpy as np

    cores = len(os.sched_getaffinity(0))
    source = np.ones(COPIED_BYTES, np.uint8)
    target = np.zeros_like(source)
    bounds = np.linspace(0, COPIED_BYTES, cores + 1).astype(int)
    parts = [slice(first, last) for first, last in pairwise(bounds)]
    seconds = []
    with ThreadPoolExecutor(cores) as pool:
        for _ in range(COPIES):
            began = time.perf_counter()
            list(pool.map(lambda part: np.copyto(target[part], source[part]), parts))
            seconds.append(time.perf_counter() - began)
    return COPIED_BYTES / min(seconds)


class Clock:
    """Seconds spent, by name."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys((*PROCESSING, "simulation"), 0.0)

    @contextmanager
    def during(self, name: str) -> Iterator[None]:
        """Count the seconds of a block."""
        began = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - began

    def inside(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a function, to count the seconds inside it."""

        def timed(*arguments: Any) -> Any:
            with self.during(name):
                return function(*arguments)

        return timed


def acquire(config: Any, name: str, shape: tuple[int, int]) -> dict[str, Any]:
    """Take a scene through all stages in a folder for the time being.

    Returns
    -------
    dict
        Seconds of each stage and of the simulation, ``patterns``, ``stored`` bytes, and
        ``bytes_per_image`` as captured and as merged.
    """
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config
    from rfpipe.stages import assemble, capture, merge, normalize, refine, schedule
    from rfpipe.stages.folder import AcquisitionFolder
    from rfpipe.stages.jobs.workers import Resources
    from rfpipe.stages.plan import Plan
    from rfpipe.store import bytes_on_disk

    clock = Clock()
    scene = config.scenes[name].model_copy(update={"shape": shape})
    threads = len(os.sched_getaffinity(0))
    resources = Resources(config.resources.memory_gib, threads)
    rig = SimulatedRig(
        scene_from_config(scene), sensor_from_config(config.camera), config.seed, threads=threads
    )
    rig.capture = clock.inside("simulation", rig.capture)  # type: ignore[method-assign]
    options = config.methods_of(name)["symmetric"].options()
    rays = scene.ray_shape, scene.ray_shape
    plan = Plan("symmetric", "symmetric", *rays, scene.channels, options)
    references = (config.capture.black_frames, config.capture.floodlit_frames)
    with TemporaryDirectory(prefix="rfpipe-bench-") as path:
        folder = AcquisitionFolder(Path(path))
        for level in folder.levels():
            with clock.during("schedule"):
                schedule.run(plan, folder, level, "")
            with clock.during("store"):
                capture.run(
                    rig, folder, level, references=references, keep_raw=False,
                    batch_patterns=config.capture.batch_patterns, resources=resources,
                )  # fmt: skip
            with clock.during("merge"):
                merge.run(
                    folder, level, **config.merge.model_dump(), code="",
                    keep_raw=False, resources=resources,
                )  # fmt: skip
            with clock.during("normalize"):
                normalize.run(plan, folder, level, mode=config.normalization, code="")
            with clock.during("refine"):
                refine.run(plan, folder, level, "", resources)
        with clock.during("assemble"):
            assemble.run(
                plan, folder, scene=name, number_format=config.storage.number_format, code=""
            )
        levels = [folder.read_manifest(level, "schedule") for level in folder.levels()]
        stored = bytes_on_disk(folder.path / "transport.zarr")
    clock.seconds["store"] -= clock.seconds["simulation"]
    raw = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    merged = 2 * 4 * prod(rig.camera_shape) * rig.channels  # float32 radiance and variance
    return {
        **clock.seconds,
        "patterns": sum(facts["patterns"] for facts in levels),
        "stored": stored,
        "bytes_per_image": raw * rig.sensor.frame_dtype.itemsize + merged,
    }


if __name__ == "__main__":
    main()
