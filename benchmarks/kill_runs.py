"""Kill runs of the workflow at random moments, end them, and compare their bytes.

    python -m benchmarks.kill_runs FOLDER [--runs 30] [--seed 1]

For each mode of resources.jobs, RUNS runs are killed by kill -9, with all of their jobs, at
moments spread over the time of an undisturbed run; unlocked; and run to their end. A table says in
which stage each was killed; the exit status is 1 where any ends with other bytes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from time import perf_counter, sleep

import yaml

from rfpipe.provenance import generator

ROOT = Path(__file__).parents[1]
TARGET = "results/tiny/dual/transport.json"
SETTINGS = {
    "scenes": {"tiny": {"kind": "wedge", "surfaces": ["white", "texture"], "shape": [5, 8]}},
    "methods": {"dual": {"tolerance": 1e-2}},
    "capture": {"batch_patterns": 1, "all_off_brackets": 4, "all_on_brackets": 4},
}
MODES = ("stage", "acquisition")


def main() -> int:
    """Kill runs of both modes; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="where the runs lie; made")
    parser.add_argument("--runs", type=int, default=30, help="runs to kill of each mode")
    parser.add_argument("--seed", type=int, default=1, help="of the moments")
    arguments = parser.parse_args()
    expected, wrong = None, 0
    for number, mode in enumerate(MODES):
        seconds = _run(arguments.folder / mode / "whole", mode)
        contents = _contents(arguments.folder / mode / "whole")
        expected = expected or contents
        wrong += contents != expected
        random = generator(arguments.seed, number)
        killed = Counter[str]()
        for run in range(arguments.runs):
            folder = arguments.folder / mode / str(run)
            moment = (run + random.uniform()) / arguments.runs * seconds
            killed[_killed(folder, mode, moment)] += 1
            _run(folder, mode)
            if _contents(folder) != expected:
                print(f"{folder}: other bytes")
                wrong += 1
            else:
                shutil.rmtree(folder)
        stages = ", ".join(f"{count} in {stage}" for stage, count in sorted(killed.items()))
        print(f"jobs: {mode}: {arguments.runs} killed, {stages}", flush=True)
    print(f"{wrong} ended with other bytes")
    return int(wrong > 0)


def _start(folder: Path, mode: str, *options: str) -> subprocess.Popen[bytes]:
    folder.mkdir(parents=True, exist_ok=True)
    settings = folder / "settings.yaml"
    settings.write_text(yaml.safe_dump({**SETTINGS, "resources": {"jobs": mode}}))
    of_run: list[str | Path] = [
        "--directory",
        folder,
        "--configfile",
        settings,
        "--cores",
        "2",
        *options,
    ]
    return subprocess.Popen(
        [Path(sys.executable).with_name("snakemake"), TARGET, "-s", ROOT / "Snakefile", *of_run],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _run(folder: Path, mode: str) -> float:
    """Run to the end; return the seconds that it took."""
    began = perf_counter()
    if _start(folder, mode).wait():
        raise SystemExit(f"{folder}: a run failed; see its .snakemake/log")
    return perf_counter() - began


def _killed(folder: Path, mode: str, moment: float) -> str:
    """Kill a run after some seconds; return the stage that wrote last."""
    process = _start(folder, mode)
    sleep(moment)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    _start(folder, mode, "--unlock").wait()
    stores = [*folder.glob("results/*/*/L*/*.zarr"), *folder.glob("results/*/*/transport.zarr")]
    return max(stores, key=lambda path: path.stat().st_mtime_ns).stem if stores else "the start"


def _contents(folder: Path) -> dict[str, bytes]:
    """Return all that the stages left, but for logs and times."""
    results = folder / "results"
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in results.rglob("*")
        if path.is_file() and not path.name.endswith((".log", ".tsv")) and path.name != "run.json"
    }


if __name__ == "__main__":
    sys.exit(main())
