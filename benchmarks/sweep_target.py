"""Symmetric and dual photography with a target error: which share of it the tolerance should be.

Usage: ``python benchmarks/sweep_target.py [--shares ...] [--scenes ...]``. Scenes of
``benchmarks.methods`` that aren't held out, unless others are named; by default 48 x 48 pixels, the
default camera, seed 1. Each acquisition is set beside one by the same tolerance, but no target.
Writes results/bench/target.csv (a quarter of an hour) and prints a summary.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd
from benchmarks.methods.cases import CAMERAS, is_held_out
from benchmarks.methods.scenes import KINDS, stage_of

import rfpipe
from rfpipe.errors import RfpipeError
from rfpipe.methods.dual import Dual
from rfpipe.methods.symmetric.method import Symmetric
from rfpipe.rigs import SimulatedRig
from rfpipe.stages.evaluating.metrics import relative_rms

OUTPUT = Path("results/bench")

METHODS = (Symmetric, Dual)
TARGETS = (0.02, 0.01, 0.005)
SHARES = (0.3, 0.5)
SAMPLES = 16384


def main() -> None:
    """Run all, write the table and print what it says of each share."""
    asked = _parsed()
    OUTPUT.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in _rows(asked):
        rows.append(row)
        print(", ".join(f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
                        for name, value in row.items()), flush=True)  # fmt: skip
        pd.DataFrame(rows).to_csv(OUTPUT / asked.name, index=False)
    print(summary(pd.DataFrame(rows)).to_string())


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=KINDS,
                        default=[name for name in KINDS if not is_held_out(name)])  # fmt: skip
    parser.add_argument("--shares", nargs="+", type=float, default=SHARES)
    parser.add_argument("--targets", nargs="+", type=float, default=TARGETS)
    parser.add_argument("--light", choices=CAMERAS, default="full")
    parser.add_argument("--side", type=int, default=48)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"))
    parser.add_argument("--name", default="target.csv", help="of the table")
    return parser.parse_args()


def _rows(asked: argparse.Namespace) -> Iterator[dict[str, object]]:
    """Acquire with and without a target; rigs that a method doesn't fit are left out."""

    @cache
    def plain(scene: str, method: str, tolerance: float) -> dict[str, float]:
        return _acquired(scene, method, asked, tolerance=tolerance)

    for scene, method in product(asked.scenes, METHODS):
        for share, target in product(asked.shares, asked.targets):
            place = {"scene": scene, "method": method.name, "share": share, "target": target}
            try:
                with patch.object(method, "tolerance_share", share):
                    found = _acquired(scene, method.name, asked, target_error=target)
            except RfpipeError:
                continue
            without = plain(scene, method.name, share * target)
            yield {**place, **found, "plain_patterns": without["patterns"],
                   "plain_error": without["error"]}  # fmt: skip


def _acquired(
    scene: str, method: str, asked: argparse.Namespace, **options: float
) -> dict[str, float]:
    """Return patterns, mean error of the benchmark's relit pictures, and what was estimated."""
    stage = stage_of(scene, asked.side, 1, SAMPLES, asked.seed, asked.cache)
    rig = SimulatedRig(stage.scene, CAMERAS[asked.light], asked.seed)
    result = rfpipe.acquire(rig, method, progress=False, **options)
    relit = result.transport.relight_batch(np.stack(list(stage.patterns.values())))
    errors = [relative_rms(*pair) for pair in zip(relit, stage.truth, strict=True)]
    found: dict[str, float] = {"patterns": result.patterns, "error": float(np.nanmean(errors))}
    if len(result.history):
        found["estimate"] = float(result.history["estimated_error"].iloc[-1])
    return found


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Tell by method and share how errors lie to targets, and what was spent.

    ``met`` is the part of acquisitions whose true error is at most the target; ``error``,
    ``estimate`` and ``patterns`` are geometric means, of the error over the target, of the estimate
    over the error, and of patterns; ``more`` is the median of patterns beyond those of the same
    tolerance without a target.
    """
    ratio = table["error"] / table["target"]
    told = pd.DataFrame(
        {
            "method": table["method"],
            "share": table["share"],
            "met": ratio <= 1,
            "error": np.log(ratio),
            "worst": np.log(ratio),
            "estimate": np.log(table["estimate"] / table["error"]),
            "patterns": np.log(table["patterns"]),
            "more": table["patterns"] - table["plain_patterns"],
        }
    )
    found = told.groupby(["method", "share"], sort=False).agg(
        {"met": "mean", "error": "mean", "worst": "max", "estimate": "mean", "patterns": "mean",
         "more": "median"}
    )  # fmt: skip
    logarithmic = ["error", "worst", "estimate", "patterns"]
    found[logarithmic] = np.exp(found[logarithmic])
    return found.round(3)


if __name__ == "__main__":
    logging.getLogger("rfpipe").setLevel(logging.ERROR)
    main()
