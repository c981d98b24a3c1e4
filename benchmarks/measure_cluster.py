"""Small scenes on a cluster of this machine: wall time against ideal, bytes against local.

Usage: ``python -m benchmarks.measure_cluster FOLDER [--scenes 40] [--group 8] [--cpus 1] [--kill]
[--local | --dask N]``. Runs the scenes at 12 x 16 by dual photography through
workflow/profiles/slurm on two nodes, as root, with Slurm's packages (docs/clusters.md); --kill
ends a node in the middle, and brings it back. --local runs them without Slurm, in FOLDER/local;
--dask by ``rfpipe acquire`` on N workers of one thread, of which --kill ends one. No part of
`make bench`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import psutil
import yaml
from distributed import Client
from tests.slurm import NODES, Slurm

from rfpipe.config import load_config
from rfpipe.costs import fit_laws, read_shipped, records_in
from rfpipe.store.files import digest_of

ROOT = Path(__file__).parents[1]
KINDS = ("wedge", "wedge_30", "wedge_120", "corner")
SURFACES = ("texture", "white")


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--scenes", type=int, default=40)
    arguments.add_argument("--group", type=int, default=1)
    arguments.add_argument("--cpus", type=int, default=1)
    arguments.add_argument("--kill", action="store_true")
    arguments.add_argument("--local", action="store_true")
    arguments.add_argument("--dask", type=int, metavar="N")
    asked = arguments.parse_args()
    name = f"dask_{asked.dask}" if asked.dask else f"slurm_{asked.group}"
    folder = asked.folder / ("local" if asked.local else name)
    folder.mkdir(parents=True)
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(_settings(asked.scenes)), encoding="utf-8")
    targets = [
        f"results/{scene}/{method}/transport.json"
        for scene, method in load_config(config).acquisitions
    ]
    command = [
        str(Path(sys.executable).with_name("snakemake")), *targets,
        "--snakefile", str(ROOT / "Snakefile"),
        "--directory", str(folder), "--configfile", str(config),
    ]  # fmt: skip
    killed_after = asked.scenes // 3 if asked.kill else None
    began = time.perf_counter()
    cores = 2 * asked.cpus
    if asked.dask:
        _tell_dask(folder, asked.folder / "local", _on_dask(config, asked.dask, killed_after))
        return
    if asked.local:
        subprocess.run([*command, "--cores", str(cores)], check=True)
    else:
        with TemporaryDirectory() as place, Slurm(Path(place) / "slurm", asked.cpus) as slurm:
            os.environ.update(slurm.environment)
            command += ["--profile", str(ROOT / "workflow" / "profiles" / "slurm")]
            if asked.group > 1:
                command += ["--groups", "acquire_simulated=small"]
                command += ["--group-components", f"small={asked.group}"]
                command += ["--cores", str(asked.cpus)]  # those of a group's jobs side by side
            _run(command, slurm, folder, killed_after)
    _tell(folder, asked.folder / "local", time.perf_counter() - began, cores)


def _settings(count: int) -> dict[str, object]:
    scenes = {}
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        surfaces = [SURFACES[number // (4 * 2**side) % 2] for side in range(2)]
        surfaces += ["white"] * (kind == "corner")
        rays = [12, 16 - number // 16]
        scenes[f"s{number:02d}"] = {"kind": kind, "surfaces": surfaces, "shape": rays}
    return {"scenes": scenes, "methods": {"dual": {}}}


def _run(command: list[str], slurm: Slurm, folder: Path, killed_after: int | None) -> None:
    process = subprocess.Popen(command)
    while killed_after is not None and process.poll() is None:
        done = len(list(folder.glob("results/*/*/transport.json")))
        if done >= killed_after and NODES[0] in slurm.jobs("RUNNING").values():
            print(f"node killed after {done} acquisitions: {slurm.kill_node(NODES[0])} processes")
            time.sleep(5)
            slurm.start_node(NODES[0])
            killed_after = None
        time.sleep(0.2)
    if process.wait():
        sys.exit("the run failed")


def _on_dask(config: Path, count: int, killed_after: int | None) -> float:
    """Acquire all on workers of one thread; return the wall time, their start left out."""
    program = Path(sys.executable).with_name
    folder = config.parent
    told = folder / "scheduler.json"
    start = [str(program("dask")), "scheduler", "--host", "127.0.0.1", "--port", "0"]
    log = (folder / "dask.log").open("wb")
    start += ["--no-dashboard", "--scheduler-file", str(told)]
    processes = [subprocess.Popen(start, stderr=log)]
    try:
        while not told.exists():
            time.sleep(0.1)
        address = json.loads(told.read_text())["address"]
        one = [str(program("dask")), "worker", address, "--nthreads", "1", "--no-dashboard"]
        processes += [subprocess.Popen(one, cwd=folder, stderr=log) for _ in range(count)]
        with Client(address) as client:
            client.wait_for_workers(count)
        began = time.perf_counter()
        acquire = [str(program("rfpipe")), "acquire", str(config), "--directory", str(folder)]
        run = subprocess.Popen([*acquire, "--workers", address])
        while run.poll() is None:
            done = len(list(folder.glob("results/*/*/transport.json")))
            if killed_after is not None and done >= killed_after:
                nanny = psutil.Process(processes[1].pid)  # it starts another one
                for child in nanny.children():
                    if any("spawn_main" in part for part in child.cmdline()):
                        child.kill()
                        print(f"worker killed after {done} acquisitions")
                killed_after = None
            time.sleep(0.1)
        if run.returncode:
            sys.exit("the run failed")
        return time.perf_counter() - began
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


def _tell_dask(folder: Path, other: Path, wall: float) -> None:
    count = len(list(folder.glob("results/*/*/transport.json")))
    print(f"{count} acquisitions, {wall:.1f} s")
    _compare(folder, other)


def _tell(folder: Path, other: Path, wall: float, cores: int) -> None:
    scenes = load_config(folder / "config.yaml").scenes
    records = [one for one in records_in(folder / "results", scenes) if one.job == "acquire"]
    table = pd.DataFrame([one.__dict__ for one in records])
    laws = fit_laws(read_shipped())
    ratio = [
        (laws.predict("memory_mb", one.job, one.subject) or 0) / one.memory_mb for one in records
    ]
    own = table["seconds"].sum()
    print(f"{len(records)} jobs, {wall:.0f} s on {cores} cores; the jobs themselves {own:.0f} s")
    print(f"ideal {own / cores:.0f} s: {wall * cores / own:.2f} times that")
    print(f"processor time of the jobs {table['cpu_seconds'].sum():.0f} s")
    print(f"memory {table['memory_mb'].min():.0f} to {table['memory_mb'].max():.0f} MB; predicted")
    print(f"{min(ratio):.2f} to {max(ratio):.2f} of it")
    _compare(folder, other)


def _compare(folder: Path, other: Path) -> None:
    if other.exists() and other != folder:
        same = _digests(folder) == _digests(other)
        print(f"bytes: {'the same' if same else 'OTHERS'} as in {other}")


def _digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): digest_of(path.read_bytes())
        for path in sorted(folder.glob("results/s*/**/*"))
        if path.is_file() and path.suffix not in (".log", ".tsv")
    }


if __name__ == "__main__":
    main()
