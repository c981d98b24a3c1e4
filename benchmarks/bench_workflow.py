"""What the workflow costs beyond the stages' own work: results/bench/workflow.csv.

Usage: ``python benchmarks/bench_workflow.py [--default-run]``. Runs the workflow on 2 cores in a
temporary folder: a plane and a wedge by three methods, or with ``--default-run`` all of the default
run, some minutes.

A row for each rule, means over its jobs: `job_s` as Snakemake measures the job (its
`benchmark:`), `process_s` from the start of the job's interpreter to its end, `loading_s` of that
for imports and for compiled kernels from their cache, wherever in the job they happen, and `own_s`,
the rest: the stage's own work. `overhead_s` is `job_s` less `own_s`. The last row is the whole run:
its wall time times its cores, over the jobs, so that Snakemake's own work and cores that wait for a
job to end count as overhead, too. The interpreters time themselves by a `sitecustomize` module that
this script puts in their way; the workflow is run as it is.
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
import yaml

OUTPUT = Path("results/bench/workflow.csv")
ROOT = Path(__file__).parents[1]
CORES = 2
SCENE = {"shape": [62, 70], "sweep": False}
SMALL = {
    "scenes": {
        "plane": {"kind": "plane", "surfaces": ["texture"], **SCENE},
        "wedge": {"kind": "wedge", "surfaces": ["texture", "texture"], **SCENE},
    },
    "methods": {"symmetric": {}, "dual": {}, "near_far": {}},
    "report": {"resolutions": [8, 16]},
}

# Runs at the start of every interpreter; reports at the end of those that run a job's script.
SITECUSTOMIZE = r'''
import time
_began = time.perf_counter()
import atexit, builtins, os, sys, threading

_import, _main = builtins.__import__, threading.get_ident()
_depth, _loading = 0, 0.0


def _load(function, *arguments, **options):
    """Call something that loads code, and count its seconds unless it is part of a loading."""
    global _depth, _loading
    if threading.get_ident() != _main:
        return function(*arguments, **options)
    _depth += 1
    began = time.perf_counter()
    try:
        return function(*arguments, **options)
    finally:
        _depth -= 1
        if not _depth:
            _loading += time.perf_counter() - began


def _counted_import(*arguments, **options):
    try:
        return _load(_import, *arguments, **options)
    finally:
        dispatcher = sys.modules.get("numba.core.dispatcher")
        if not _depth and dispatcher and not hasattr(dispatcher, "counted"):
            dispatcher.counted = True
            _count_kernels(dispatcher.Dispatcher)


def _count_kernels(kind):
    compile_for = kind.compile

    def counted(self, *arguments, **options):
        return _load(compile_for, self, *arguments, **options)

    kind.compile = counted


def _report():
    import json

    script = sys.argv[0] if sys.argv else ""
    if f"{os.sep}.snakemake{os.sep}scripts{os.sep}" not in script:
        return
    times = {
        "stage": os.path.basename(script).split(".")[-2],
        "process_s": time.perf_counter() - _began,
        "loading_s": _loading,
    }
    path = os.path.join(os.environ["RFPIPE_BENCH_TIMES"], f"{os.getpid()}.json")
    with open(path, "w") as file:
        json.dump(times, file)


builtins.__import__ = _counted_import
atexit.register(_report)
'''


def main() -> None:
    """Run, and write the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--default-run", action="store_true", help="all of the default run")
    config: dict[str, object] = SMALL
    if parser.parse_args().default_run:
        config = yaml.safe_load((ROOT / "config" / "config.yaml").read_text(encoding="utf-8"))
    with TemporaryDirectory(prefix="rfpipe-bench-") as folder:
        table = measure(Path(folder), config)
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(OUTPUT, index=False, float_format="%.4g")
    print(table.to_string(index=False))


def measure(folder: Path, config: dict[str, object]) -> pd.DataFrame:
    """Run the workflow in a folder; return the table."""
    (folder / "config.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    for name in ("site", "times", "run"):
        (folder / name).mkdir()
    (folder / "site" / "sitecustomize.py").write_text(SITECUSTOMIZE, encoding="utf-8")
    own_path = os.environ.get("PYTHONPATH")
    path = [str(folder / "site"), *([own_path] if own_path else [])]
    began = time.perf_counter()
    subprocess.run(
        [
            str(Path(sys.executable).with_name("snakemake")),
            *("--snakefile", str(ROOT / "Snakefile"), "--directory", str(folder / "run")),
            *("--configfile", str(folder / "config.yaml"), "--cores", str(CORES)),
        ],
        check=True,
        cwd=ROOT,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path),
            "RFPIPE_BENCH_TIMES": str(folder / "times"),
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wall = time.perf_counter() - began
    inside = pd.DataFrame(json.loads(path.read_text()) for path in (folder / "times").iterdir())
    inside["own_s"] = inside["process_s"] - inside["loading_s"]
    return summary(inside, snakemake_seconds(folder / "run" / "results"), wall)


def snakemake_seconds(results: Path) -> pd.DataFrame:
    """Read what Snakemake measured of each job."""
    # the rules' names where the files that they write have others
    names = {"capture": "capture_simulated", "verification": "verify"}
    names |= dict.fromkeys((path.stem for path in results.glob("studies/*.json")), "studies")
    rows = []
    for path in results.rglob("*.benchmark.tsv"):
        name = path.name.removesuffix(".benchmark.tsv")
        seconds = float(pd.read_csv(path, sep="\t")["s"].iloc[0])
        rows.append({"stage": names.get(name, name), "job_s": seconds})
    return pd.DataFrame(rows)


def summary(inside: pd.DataFrame, seen: pd.DataFrame, wall: float) -> pd.DataFrame:
    """Return the table: a row a rule, their mean, and the whole run."""
    if missing := set(seen["stage"]) ^ set(inside["stage"]):
        raise SystemExit(f"no times of both kinds for the rules {sorted(missing)}")
    jobs = len(inside)
    table = inside.groupby("stage").mean().join(seen.groupby("stage").mean())
    table.insert(0, "jobs", inside.groupby("stage").size())
    table = table.reset_index().sort_values("jobs", ascending=False, kind="stable")
    means = {name: (table[name] * table["jobs"]).sum() / jobs for name in table.columns[2:]}
    every = {"stage": "every job", "jobs": jobs, **means}
    run = {**every, "stage": "whole run", "job_s": CORES * wall / jobs}
    table = pd.concat([table, pd.DataFrame([every, run])], ignore_index=True)
    table["overhead_s"] = table["job_s"] - table["own_s"]
    return table[["stage", "jobs", "job_s", "process_s", "loading_s", "own_s", "overhead_s"]]


if __name__ == "__main__":
    main()
