"""Effect of decision thresholds: ``python -m benchmarks.methods.thresholds [--targets 0.01]``.

Each threshold is decreased and increased separately, and `auto` acquires the open scenes, seed 1,
in full light. A row has the ratio of patterns to the present thresholds, and of the mean error to
the target, as geometric means over scenes; results/bench/thresholds.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.harness import write
from benchmarks.methods.cases import Case
from benchmarks.methods.measure import measure
from rfpipe.methods.adaptive import decisions
from rfpipe.methods.adaptive.footprints.method import Footprints
from rfpipe.methods.adaptive.near_far import NearFar

SCENES = ("two_blocks", "red_wall_box", "translucent", "foreshortened", "glass_and_ring",
          "wedge_iv", "wedge_30", "wedge_120", "wedge_aside", "bottle")  # fmt: skip

CHANGED: dict[str, tuple[Any, ...]] = {
    "stalled": (0.7, 0.95),
    "slowest": (0.12, 0.5),
    "least": ((3, 0.05), (12, 0.2)),
    "ample": (0.9, 1.4),
    "nearly": (1.0, 1.5),
    "noise": (1.1, 2.5),
    "symmetric": ((20.0, 0.55), (45.0, 0.55)),
    "dual": ((30.0, 0.75), (70.0, 0.75)),
    "lost": (0.6, 1.7),
    "tolerance": (0.6, 1.7),
}
"""Of `decisions.Thresholds`; of both ways, `lost` and `tolerance` are multiplied."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Change one threshold after the other."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.methods.thresholds")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--targets", nargs="+", type=float, default=[0.01])
    parser.add_argument("--only", nargs="+", choices=CHANGED, default=list(CHANGED))
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"))
    options = parser.parse_args(arguments)
    write("thresholds", rows(options.scenes, options.targets, options.only, options.cache))


def rows(
    scenes: Sequence[str], targets: Sequence[float], names: Sequence[str], cache: Path
) -> Iterator[dict[str, Any]]:
    """Yield a row for each value of each threshold."""
    places = list(product(scenes, targets))
    before = [acquired(*place, cache) for place in places]
    for name, value in [(threshold, value) for threshold in names for value in CHANGED[threshold]]:
        with changed(name, value):
            after = [acquired(*place, cache) for place in places]
        more = [b["patterns"] / a["patterns"] for a, b in zip(before, after, strict=True)]
        worse = [b["error_mean"] / a["error_mean"] for a, b in zip(before, after, strict=True)]
        missed = [row["error_mean"] > 1.2 * row["value"] for row in after]
        yield {
            "threshold": name,
            "value": value,
            "patterns": float(np.exp(np.mean(np.log(more)))),
            "least": min(more),
            "most": max(more),
            "error": float(np.exp(np.mean(np.log(worse)))),
            "missed": sum(missed),
            "of": len(places),
        }


def changed(name: str, value: Any) -> ExitStack:
    """Return a context in which a threshold has another value."""
    stack = ExitStack()
    if name in {field.name for field in fields(decisions.Thresholds)}:
        stack.enter_context(patch.object(decisions, "_AT", replace(decisions._AT, **{name: value})))
    for method, law in ((NearFar, "symmetric"), (Footprints, "dual")):
        way = method.way
        overrides = {law: {"law": value}, name: {name: value * getattr(way, name, 0)}}
        if name == law or name in ("lost", "tolerance"):
            stack.enter_context(patch.object(method, "way", replace(way, **overrides[name])))
    return stack


def acquired(scene: str, target: float, cache: Path) -> dict[str, Any]:
    """Acquire a scene by `auto`; a row as `measure` has it."""
    return dict(
        measure(
            Case(scene, "48", 1, 16384, "full", 1, "auto", "target_error", target),
            cache,
        )
    )


if __name__ == "__main__":
    main()
