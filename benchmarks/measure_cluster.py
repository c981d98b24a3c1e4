"""Small scenes on a cluster of this machine: wall time against ideal, bytes against local.

Usage: ``python -m benchmarks.measure_cluster FOLDER [--scenes 40] [--group 8] [--cpus 1] [--kill]
[--local]``. Runs the scenes at 12 x 16 by dual photography, a job each, through
workflow/profiles/slurm on two nodes, as root, with Slurm's packages (docs/clusters.md); --kill
ends a node in the middle, and brings it back. --local runs them without Slurm, in FOLDER/local. No
part of `make bench`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import yaml
from tests.services.slurm import NODES, Slurm

from rfpipe.config import load_config
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
    options = arguments.parse_args()
    folder = options.folder / ("local" if options.local else f"slurm_{options.group}")
    folder.mkdir(parents=True)
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(_settings(options.scenes)), encoding="utf-8")
    targets = [
        f"results/{scene}/{method}/transport.json"
        for scene, method in load_config(config).acquisitions
    ]
    command = [
        str(Path(sys.executable).with_name("snakemake")), *targets,
        "--snakefile", str(ROOT / "Snakefile"),
        "--directory", str(folder), "--configfile", str(config),
    ]  # fmt: skip
    killed_after = options.scenes // 3 if options.kill else None
    began = time.perf_counter()
    cores = 2 * options.cpus
    if options.local:
        subprocess.run([*command, "--cores", str(cores)], check=True)
    else:
        with TemporaryDirectory() as place, Slurm(Path(place) / "slurm", options.cpus) as slurm:
            os.environ.update(slurm.environment)
            command += ["--profile", str(ROOT / "workflow" / "profiles" / "slurm")]
            if options.group > 1:
                command += ["--groups", "acquire=small"]
                command += ["--group-components", f"small={options.group}"]
                command += ["--cores", str(options.cpus)]  # of a group's parallel jobs
            _run(command, slurm, folder, killed_after)
    _tell(folder, options.folder / "local", time.perf_counter() - began, cores)


def _settings(count: int) -> dict[str, object]:
    scenes = {}
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        surfaces = [SURFACES[number // (4 * 2**side) % 2] for side in range(2)]
        surfaces += ["white"] * (kind == "corner")
        rays = [12, 16 - number // 16]
        scenes[f"s{number:02d}"] = {"kind": kind, "surfaces": surfaces, "shape": rays}
    return {"scenes": scenes, "methods": {"dual": {}}, "resources": {"jobs": "acquisition"}}


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


def _tell(folder: Path, second_folder: Path, wall: float, cores: int) -> None:
    files = sorted(folder.glob("results/*/*/acquire.benchmark.tsv"))
    table = pd.concat([pd.read_csv(file, sep="\t") for file in files])
    job_seconds = table["s"].sum()
    print(
        f"{len(table)} jobs, {wall:.0f} s on {cores} cores; the jobs themselves {job_seconds:.0f} s"
    )
    print(f"ideal {job_seconds / cores:.0f} s: {wall * cores / job_seconds:.2f} times that")
    print(f"processor time of the jobs {table['cpu_time'].sum():.0f} s")
    print(f"memory {table['max_rss'].min():.0f} to {table['max_rss'].max():.0f} MiB")
    if second_folder.exists() and second_folder != folder:
        same = _digests(folder) == _digests(second_folder)
        print(f"bytes: {'the same' if same else 'OTHERS'} as in {second_folder}")


def _digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): digest_of(path.read_bytes())
        for path in sorted(folder.glob("results/s*/**/*"))
        if path.is_file() and path.suffix not in (".log", ".tsv")
    }


if __name__ == "__main__":
    main()
