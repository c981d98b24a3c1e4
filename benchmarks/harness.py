"""What the scripts share: their tables, the shortest of several times, and errors of pictures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

FOLDER = Path("results/bench")


def write(name: str, rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Write ``results/bench/{name}.csv`` anew after each row, so that a stopped script leaves some.

    Returns
    -------
    DataFrame
        All rows; each is printed as it comes.
    """
    FOLDER.mkdir(parents=True, exist_ok=True)
    done: list[Mapping[str, Any]] = []
    for row in rows:
        done.append(row)
        print(", ".join(f"{key} {_text(value)}" for key, value in row.items()), flush=True)
        pd.DataFrame(done).to_csv(FOLDER / f"{name}.csv", index=False, float_format="%.5g")
    return pd.DataFrame(done)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def shortest_ms(seconds: float = 4.0, **actions: Callable[[], object]) -> dict[str, float]:
    """Return the shortest time of each action in ms, warm; all of them in turn for so long."""
    for action in actions.values():
        action()  # compiles, or loads what was compiled
    shortest = dict.fromkeys(actions, np.inf)
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        for name, action in actions.items():
            for _ in range(3):
                start = time.perf_counter()
                action()
                shortest[name] = min(shortest[name], time.perf_counter() - start)
    return {name: 1e3 * took for name, took in shortest.items()}


def errors(images: NDArray[Any], truth: NDArray[Any]) -> NDArray[np.float64]:
    """Return the relative RMS error of each picture; NaN of black ones."""
    true = np.asarray(truth, np.float64).reshape(len(truth), -1)
    difference = np.asarray(images, np.float64).reshape(len(truth), -1) - true
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.linalg.norm(difference, axis=1) / np.linalg.norm(true, axis=1)
    return np.asarray(relative)
