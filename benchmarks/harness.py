"""Shared functions of the scripts: tables, shortest of several times, errors of pictures."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from rfpipe.store.files import write_atomically

T = TypeVar("T")

FOLDER = Path("results/bench")


def given(
    name: str,
    kind: Callable[[str], T],
    default: Sequence[T] = (),
    choices: Container[T] | None = None,
) -> list[T]:
    """Return a script's arguments; a wrong one ends the script with a message.

    Parameters
    ----------
    name : str
        The arguments' name in the message.
    kind : callable
        Returns an argument's value, or raises ValueError.
    default, choices
        Values without arguments, and those that are possible; any where None.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument(name, nargs="*", type=kind, choices=choices, default=list(default))  # type: ignore[arg-type]
    return list(getattr(parser.parse_args(), name))


def is_full() -> bool:
    """Test whether a script was called with ``--full``, its only option."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--full", action="store_true")
    return bool(parser.parse_args().full)


def existing(text: str) -> Path:
    """Return the path of a file or folder; ValueError where there is none."""
    if not Path(text).exists():
        raise argparse.ArgumentTypeError(f"there is no file or folder {text}")
    return Path(text)


def image_size(text: str) -> tuple[int, int]:
    """Parse ``HEIGHTxWIDTH``."""
    height, width = map(int, text.split("x"))
    return height, width


def write(name: str, rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Rewrite ``results/bench/{name}.csv`` after each row, so that a stopped script leaves rows.

    Returns
    -------
    DataFrame
        All rows; each is printed as it comes.
    """
    done: list[Mapping[str, Any]] = []
    for row in rows:
        done.append(row)
        print(", ".join(f"{key} {_text(value)}" for key, value in row.items()), flush=True)
        text = pd.DataFrame(done).to_csv(index=False, float_format="%.5g")
        write_atomically(FOLDER / f"{name}.csv", text.encode())
    return pd.DataFrame(done)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def shortest_ms(seconds: float = 4.0, **actions: Callable[[], object]) -> dict[str, float]:
    """Return the shortest time of each action in ms, warm; all of them in turn for so long."""
    for action in actions.values():
        action()  # compiles, or loads compiled code
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
