"""Effect of decision thresholds: ``python -m benchmarks.methods.thresholds [--targets 0.01]``.

Each threshold is decreased and increased separately, and `auto` acquires tuning scenes, seed 1,
in full light. A row has the ratio of patterns to the present thresholds, and of the mean error to
the target, as geometric means over scenes; results/bench/thresholds.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.harness import write
from benchmarks.methods.cases import Case
from benchmarks.methods.measure import measure
from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive import decisions, forecast, state
from rfpipe.methods.footprints import method as footprints
from rfpipe.methods.near_far import method as near_far

SCENES = ("two_blocks", "red_wall_box", "translucent", "foreshortened", "glass_and_ring",
          "wedge_iv", "wedge_30", "wedge_120", "wedge_aside", "bottle")  # fmt: skip

Change = tuple[object, str, Any]
"""An object, the name of its attribute, and another value of the attribute."""


def constant(
    name: str, *values: Any, module: ModuleType = decisions
) -> list[tuple[Any, list[Change]]]:
    """Return other values of a module's constant."""
    return [(value, [(module, name, value)]) for value in values]


def hierarchy_patterns(factor: float) -> list[Change]:
    """Multiply the number of patterns that a hierarchy is expected to take."""

    def multiplied(projector: RayDomain, target: float) -> float:
        return factor * present(projector, target)

    present = forecast.hierarchy_patterns
    return [(module, "hierarchy_patterns", multiplied) for module in (decisions, forecast)]


def hierarchy_tolerance(factor: float) -> list[Change]:
    """Multiply the tolerance of the hierarchy."""
    return [(state, "HIERARCHY_TOLERANCE", factor * state.HIERARCHY_TOLERANCE)]


def wrong_model(factor: float) -> list[Change]:
    """Multiply the first error from which on a hierarchy takes over."""
    modules = (near_far, footprints)
    return [(module, "WRONG_MODEL", factor * module.WRONG_MODEL) for module in modules]


CHANGES: dict[str, list[tuple[Any, list[Change]]]] = {
    "stalled": constant("STALLED", 0.7, 0.95),
    "slowest_power": constant("SLOWEST_POWER", 0.12, 0.5, module=forecast),
    "least_patterns": constant("LEAST_PATTERNS", 3, 12),
    "least_share": constant("LEAST_SHARE", 0.05, 0.2),
    "extrapolation": constant("EXTRAPOLATION_MARGIN", 0.9, 1.4),
    "nearly": constant("NEARLY", 1.0, 1.5),
    "noise": constant("MOSTLY_NOISE", 1.1, 2.5),
    "hierarchy_patterns": [(factor, hierarchy_patterns(factor)) for factor in (0.67, 1.5)],
    "tolerance": [(factor, hierarchy_tolerance(factor)) for factor in (0.6, 1.7)],
    "wrong_model": [(factor, wrong_model(factor)) for factor in (0.6, 1.7)],
}
"""Two other values of each threshold; the last three have factors."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Change one threshold after the other."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.methods.thresholds")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--targets", nargs="+", type=float, default=[0.01])
    parser.add_argument("--only", nargs="+", choices=CHANGES, default=list(CHANGES))
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"))
    options = parser.parse_args(arguments)
    write("thresholds", rows(options.scenes, options.targets, options.only, options.cache))


def rows(
    scenes: Sequence[str], targets: Sequence[float], names: Sequence[str], cache: Path
) -> Iterator[dict[str, Any]]:
    """Yield a row for each value of each threshold."""
    places = list(product(scenes, targets))
    before = [acquired(*place, cache) for place in places]
    for name, value, changes in [(key, *change) for key in names for change in CHANGES[key]]:
        with changed(changes):
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


def changed(changes: Sequence[Change]) -> ExitStack:
    """Return a context in which attributes have other values."""
    stack = ExitStack()
    for owner, name, value in changes:
        stack.enter_context(patch.object(owner, name, value))
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
