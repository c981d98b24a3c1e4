"""Digits that hold on another processor: ``python -m benchmarks.processors``.

The same acquisitions with OpenBLAS' kernels and Numba's instructions of other processors, and with
two threads, compared with this processor and one thread. A row an acquisition: patterns
of both, and relative differences in per cent; results/bench/processors.csv.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.harness import write
from benchmarks.methods.cases import Case
from benchmarks.methods.measure import measure

_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")

PROCESSORS: dict[str, dict[str, str]] = {
    "OpenBLAS of Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS of Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "Numba of any x86-64": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "two threads": dict.fromkeys(_THREADS, "2"),
}
"""Environment variables by which the libraries take this processor for another one."""

ACQUISITIONS = (
    ("wedge_iv", "near_far", "target_error", 0.01),
    ("wedge_iv", "symmetric", "tolerance", 1e-3),
    ("wedge_iv", "dual", "tolerance", 1e-3),
    ("wedge_30", "auto", "target_error", 0.01),
    ("wedge_30", "auto", "target_error", 0.005),
    ("wedge_aside", "auto", "target_error", 0.01),
    ("wedge_aside", "auto", "target_error", 0.005),
)
"""Scene, method, option and its value."""

_SIDE = "24x27"
_COMPARED = {
    "mean": "error_mean",
    "indirect": "indirect_mean",
    "largest": "error_worst",
    "estimated": "estimated_error",
    "MB": "stored_mb",
}


def measured() -> list[dict[str, Any]]:
    """Acquire in this process; return the rows of `measure`."""
    cases = (
        Case(scene, _SIDE, 3, 1, "full", 1, method, option, value)
        for scene, method, option, value in ACQUISITIONS
    )
    return [measure(case, Path()) for case in cases]


def on(variables: Mapping[str, str]) -> list[dict[str, Any]]:
    """Acquire in another process with environment variables, by default with one thread."""
    command = [sys.executable, "-m", "benchmarks.processors", "--rows"]
    environment = {**os.environ, **dict.fromkeys(_THREADS, "1"), **variables}
    ended = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    rows: list[dict[str, Any]] = json.loads(ended.stdout.splitlines()[-1])
    return rows


def rows() -> Iterator[dict[str, Any]]:
    """Yield a row for each processor and acquisition."""
    reference = on({})
    for processor, variables in PROCESSORS.items():
        for before, after in zip(reference, on(variables), strict=True):
            names = ("scene", "method", "value")
            differences = {
                name: 100 * (after[column] / before[column] - 1)
                for name, column in _COMPARED.items()
                if isinstance(before[column], float) and not math.isnan(before[column])
            }
            yield {"processor": processor, **{name: before[name] for name in names},
                   "patterns here": before["patterns"], "patterns": after["patterns"],
                   **differences}  # fmt: skip


if __name__ == "__main__":
    if "--rows" in sys.argv:
        print(json.dumps(measured(), default=str))
    else:
        write("processors", rows())
