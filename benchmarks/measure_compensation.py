"""A checkerboard on textured creases, with and without inter-reflections in the model.

Usage: ``python -m benchmarks.measure_compensation [SIDE ...]``, by default 48. Patterns are
computed from the exact transport and from a transport that `auto` acquires with noise, each with
all light and with direct light alone, and projected onto the simulated scene. Errors are relative
to the wished picture, over the pixels within reach of the former. Writes
results/bench/compensation.csv.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rfpipe
from benchmarks.harness import given, write
from benchmarks.methods.scenes import stage_of

_SCENES = ("wedge_30", "wedge_iii", "wedge_iv", "wedge_120")


def rows(side: int) -> Iterator[dict[str, Any]]:
    """Yield a row for each scene and transport."""
    row, column = np.indices((side, side)) * 8 // side
    for name in _SCENES:
        scene = stage_of(name, str(side), 1, 1, 1, Path()).scene
        # a half and a quarter of what nine tenths of the pixels surpass when floodlit
        wished = np.quantile(scene.floodlit, 0.1) * (1 + (row + column) % 2) / 4

        def off(pattern: NDArray[Any], within: NDArray[np.bool_]) -> float:
            picture = scene.apply(pattern.reshape(1, -1)).reshape(side, side)  # noqa: B023
            return float(
                np.linalg.norm((picture - wished)[within]) / np.linalg.norm(wished[within])  # noqa: B023
            )

        for method, noise in (("brute_force", None), ("auto", rfpipe.CameraModel())):
            rig = rfpipe.OperatorRig(scene, scene.shape, scene.shape, noise, seed=1)
            result = rfpipe.acquire(rig, method, progress=False)
            solution = result.transport.pattern_for(wished)
            direct = result.transport.separate(np.ones(scene.shape)).direct[..., 0]
            by_direct_light = np.clip(wished / np.maximum(direct, 1e-6), 0, 1).astype(np.float32)
            within = ~solution.out_of_reach
            yield {"scene": name, "side": side, "by": method, "patterns": result.patterns,
                   "within reach": float(within.mean()), "all light": off(solution.pattern, within),
                   "direct light": off(by_direct_light, within)}  # fmt: skip


if __name__ == "__main__":
    write("compensation", (r for side in given("side", int, [48]) for r in rows(side)))
