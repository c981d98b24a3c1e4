"""Processor time and peak memory of ``rfpipe fit``, measured in a separate process.

The peak memory of a process starts at the peak of its parent process. Therefore a small
intermediate process, this module, starts the fit and writes its usage as JSON.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FitRun:
    """Usage and text of one ``rfpipe fit``.

    Attributes
    ----------
    seconds : float
        Processor time, user and system.
    peak_gib : float
        Peak resident memory in GiB.
    text : str
        Standard output and error.
    failed : bool
    """

    seconds: float
    peak_gib: float
    text: str
    failed: bool


def run_fit(folder: Path, output: Path, *options: str) -> FitRun:
    """Run ``rfpipe fit folder -o output`` with options, as a new process."""
    arguments = [str(folder), "-o", str(output), *options]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.photographs.runs", *arguments],
        check=True, stdout=subprocess.PIPE,
    )  # fmt: skip
    return FitRun(**json.loads(done.stdout))


def _measure(arguments: list[str]) -> FitRun:
    """Run the fit as a child of this process."""
    done = subprocess.run(
        [sys.executable, "-m", "rfpipe.cli", "fit", *arguments],
        check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = usage.ru_utime + usage.ru_stime
    return FitRun(seconds, usage.ru_maxrss / 2**20, done.stdout, done.returncode != 0)


if __name__ == "__main__":
    print(json.dumps(vars(_measure(sys.argv[1:]))))
