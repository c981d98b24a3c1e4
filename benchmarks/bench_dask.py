"""Measure where work inside a job is best done: threads, or workers of dask.

Usage: ``python -m benchmarks.bench_dask [ROUNDS] FOLDER...``, each folder an acquisition by
``symmetric`` that a run left with its raw exposures, ``results/{scene}/symmetric``. Each use by two
threads and two local dask workers, one after the other in each round; what a job pays, the
connection to the scheduler, is in. Writes results/bench/dask.csv: seconds of wall and processor of
all processes, and their ratio to the threads of the same round, median and least.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
import psutil

from rfpipe.jobs.workers import Resources
from rfpipe.stages import merge
from rfpipe.stages.context import CaptureContext
from rfpipe.storage.files import FolderStorage
from rfpipe.store import PictureStore, read_manifest

OUTPUT = Path("results/bench")
PIECES = 100

Use = Callable[[Resources], object]


def nothing(first: int, _last: int) -> int:
    """A piece of no work."""
    return first


def merged_anew(folder: FolderStorage, level: int, resources: Resources) -> None:
    """Merge a level's brackets."""
    PictureStore.discard(folder.store(level, "merge"))
    merge.run(CaptureContext(folder, resources=resources), level)


def idle(folder: Path, resources: Resources) -> None:
    """Hand out pieces of no work."""
    with resources.workers(1, folder) as workers:
        list(workers.results(nothing, [(i, i + 1) for i in range(PIECES)]))


def uses(source: Path, place: Path) -> Iterator[tuple[str, Use]]:
    """Yield the measurements, on a copy of an acquisition."""
    manifest = read_manifest(source / "transport.json")
    level = max(range(1, len(manifest["levels"])), key=lambda n: manifest["levels"][n]["patterns"])
    parts = ["L00", f"L{level:02d}", "transport.zarr"]
    above = range(1, level)
    for part in [*parts, *(f"L{n:02d}" for n in above)]:
        ignored = None if part in parts else shutil.ignore_patterns("capture.zarr", "merge.zarr")
        shutil.copytree(source / part, place / part, ignore=ignored)
    for file in source.glob("*.json"):
        shutil.copy(file, place)
    folder = FolderStorage(place)
    yield "overhead", partial(idle, place)
    yield (
        f"merge, {manifest['levels'][level]['patterns']} patterns",
        partial(merged_anew, folder, level),
    )


def cpu_seconds() -> float:
    """Processor seconds of this process and all that it started."""
    times = os.times()
    total = times.user + times.system + times.children_user + times.children_system
    for child in psutil.Process().children(recursive=True):
        try:
            child_seconds = child.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += (
            child_seconds.user
            + child_seconds.system
            + child_seconds.children_user
            + child_seconds.children_system
        )
    return total


def main() -> None:
    """Measure, print and write the table."""
    from distributed import LocalCluster

    given = sys.argv[1:]
    rounds, folders = (given[0], given[1:]) if given and given[0].isdigit() else ("3", given)
    if not folders:  # as `make bench` calls it
        print("name acquisitions by symmetric with raw exposures: results/SCENE/symmetric")
        return
    rows: list[dict[str, Any]] = []
    with LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
        ways = {
            "2 threads": Resources(threads=2),
            "2 dask workers": Resources(threads=2, where=cluster.scheduler_address),
        }
        for source in folders:
            with tempfile.TemporaryDirectory() as place:
                for use, work in uses(Path(source), Path(place)):
                    rows += measured(use, work, ways, int(rounds))
                    print(pd.DataFrame(rows[-len(ways) :]).to_string(index=False), flush=True)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(OUTPUT / "dask.csv", index=False)


def measured(use: str, work: Use, ways: dict[str, Resources], rounds: int) -> list[dict[str, Any]]:
    """Measure one use by all ways, in turn, after a round that isn't counted."""
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for turn in range(rounds + 1):
        for name, resources in ways.items():
            began = perf_counter(), cpu_seconds()
            work(resources)
            took = perf_counter() - began[0], cpu_seconds() - began[1]
            if turn:
                seconds[name].append(took)
    reference = np.array(seconds["2 threads"])
    rows = []
    for name, samples in seconds.items():
        wall, cpu = np.array(samples).T
        ratio = wall / reference[:, 0]
        rows.append(
            {
                "use": use, "how": name, "wall_s": wall.min(), "cpu_s": cpu.min(),
                "ratio": np.median(ratio), "least_ratio": ratio.min(),
                "cpu_ratio": np.median(cpu / reference[:, 1]),
            }
        )  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
