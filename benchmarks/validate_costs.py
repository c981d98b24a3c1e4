"""How well jobs' memory and time are predicted: each kind of record from those without it.

Usage: ``python benchmarks/validate_costs.py [FOLDER ...]``. Prints, for the shipped table, ratios
of what was predicted to what was measured where laws were fitted without all records of a size, or
of a method; then, for each folder given, with ``config.yaml`` and ``results``, what the shipped
table says of its jobs, none of which it has. No part of `make bench`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from rfpipe.config import load_config
from rfpipe.costs import Record, fit_laws, read_shipped, records_in
from rfpipe.costs.model import Quantity


def main() -> None:
    shipped = read_shipped()
    quantities: tuple[Quantity, ...] = ("memory_mb", "cpu_seconds")
    kinds: dict[str, Callable[[Record], object]] = {
        "without its size": lambda one: one.subject.size,
        "without its method": lambda one: one.method,
    }
    rows = []
    for quantity in quantities:
        for kind, group in kinds.items():
            found = []
            for left_out in sorted({group(one) for one in shipped}, key=str):
                rest = [one for one in shipped if group(one) != left_out]
                tried = [one for one in shipped if group(one) == left_out]
                found += _ratios(quantity, rest, tried)
            rows.append(_row(quantity, kind, found))
        for folder in sys.argv[1:]:
            scenes = load_config(Path(folder) / "config.yaml").scenes
            tried = records_in(Path(folder) / "results", scenes)
            rows.append(_row(quantity, folder, _ratios(quantity, shipped, tried)))
    print(pd.DataFrame(rows).to_string(index=False))


def _ratios(
    quantity: Quantity, known: Sequence[Record], tried: Sequence[Record]
) -> list[tuple[float, Record]]:
    laws = fit_laws(known)
    found = []
    for one in tried:
        predicted = laws.predict(quantity, one.job, one.subject)
        if predicted is not None:
            found.append((predicted / getattr(one, quantity), one))
    return found


def _row(quantity: str, kind: str, found: Sequence[tuple[float, Record]]) -> dict[str, object]:
    ratios = np.array([ratio for ratio, _ in found])
    worst = max(found, key=lambda it: abs(np.log(it[0])))
    return {
        "of": quantity,
        "predicted": kind,
        "jobs": len(ratios),
        "within 30 %": f"{100 * np.mean(abs(ratios - 1) <= 0.3):.0f} %",
        "least": f"{ratios.min():.2f}",
        "median": f"{np.median(ratios):.2f}",
        "most": f"{ratios.max():.2f}",
        "worst": f"{worst[1].job} {worst[1].scene} {worst[1].method}",
    }


if __name__ == "__main__":
    main()
