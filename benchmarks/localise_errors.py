"""Errors of symmetric and dual photography against their tolerance, in exact radiance.

Usage: ``python -m benchmarks.localise_errors [--side N] [SCENE ...]``, scenes of Mitsuba by name,
by default a box with two blocks and one with a red wall (needs the extra mitsuba; at 48 x 48 some
ten minutes a scene). Their light is recorded with 16,384 samples, the red channel is acquired; by
dual photography alone where camera and projector aren't coaxial. For symmetric photography the
error of half-lit pictures is split by the kind and the level of the leaves. Adds
to results/bench/tolerance.csv and results/bench/tolerance_leaves.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import rfpipe
from rfpipe.array_types import Double
from rfpipe.mitsuba.scene import MitsubaOptions, MitsubaScene
from rfpipe.mitsuba.worlds import WORLDS
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.stages.evaluate import relative_rms
from rfpipe.transport.hierarchical.transport import HierarchicalTransport

OUTPUT = Path("results/bench")
SCENES = ("two_blocks", "red_wall_box")
TOLERANCES = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
_KINDS = ("empty", "scalar", "rank 1")
_SMALL = 4  # of the pictures are a crease and spots
_CREASE = 0.02  # of the pixels
_HALF_LIT = 8  # random pictures to localise errors by


def recorded(scene: str, side: int) -> MitsubaScene:
    """Return a scene whose light is recorded."""
    options = MitsubaOptions(
        kind="rfpipe.mitsuba.scene:MitsubaScene", scene=scene, shape=(side, side), samples=16384
    )
    return MitsubaScene(options)


def pictures(matrix: Double, side: int) -> Double:
    """Return relighting patterns and a half-lit one, then a crease and three spots, (P, N)."""
    shape = height, width = side, side
    patterns = list(relighting_patterns(shape).values())
    patterns.append(np.broadcast_to(np.arange(width) < width // 2, shape).astype(np.float32))
    patterns.append(_crease(matrix, shape).astype(np.float32))
    random = np.random.default_rng(5)
    for spot in (1, 2, 3):
        top, column = random.integers(0, height - spot), random.integers(0, width - spot)
        patterns.append(np.zeros(shape, np.float32))
        patterns[-1][top : top + spot, column : column + spot] = 1
    return np.stack(patterns).reshape(len(patterns), -1).astype(np.float64)


def _crease(matrix: Double, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels that exchange most light with their neighbours, (H, W)."""
    height, width = shape
    near, rays = np.zeros(height * width), np.arange(height * width).reshape(shape)
    for down, right in ((0, 1), (1, 0), (1, 1)):
        first, second = rays[: height - down, : width - right].ravel(), rays[down:, right:].ravel()
        near[first] += matrix[first, second]
        near[second] += matrix[first, second]
    return (near >= np.quantile(near, 1 - _CREASE)).reshape(shape)


def by_leaf(transport: HierarchicalTransport, matrix: Double) -> list[dict[str, Any]]:
    """Tell the error of random half-lit pictures apart by kind, level and place of leaves."""
    tree, rays = transport.tree, len(matrix)
    order = tree.order
    unit = np.eye(rays, dtype=np.float32).reshape(rays, *tree.domain.shape)
    error = transport.relight_batch(unit).reshape(rays, rays).T - matrix
    error, truth = error[np.ix_(order, order)], matrix[np.ix_(order, order)]
    kind, level = np.zeros((rays, rays), np.int8), np.full((rays, rays), -1, np.int8)
    on_diagonal = np.zeros((rays, rays), np.bool_)
    for leaves in transport.leaf_sets:
        starts, scalar = tree.starts[leaves.level], leaves.level == tree.n_levels - 1
        for a, b in zip(leaves.block_a, leaves.block_b, strict=True):
            for first, second in ((a, b), (b, a)):
                place = (
                    slice(starts[first], starts[first + 1]),
                    slice(starts[second], starts[second + 1]),
                )
                kind[place] = 1 if scalar else 2
                level[place], on_diagonal[place] = leaves.level, a == b
    lit = np.random.default_rng(0).integers(0, 2, (rays, _HALF_LIT)).astype(np.float64)
    norm = np.linalg.norm(truth @ lit)
    rows = []
    for which in np.unique(np.stack([kind.ravel(), level.ravel(), on_diagonal.ravel()]), axis=1).T:
        selected = (kind == which[0]) & (level == which[1]) & (on_diagonal == which[2])
        part = np.where(selected, error, 0.0)
        rows.append(
            {
                "kind": _KINDS[which[0]],
                "level": int(which[1]),
                "diagonal": bool(which[2]),
                "area": float(selected.mean()),
                "half_lit_error": float(np.linalg.norm(part @ lit) / norm),
                "of_one_sign": float(part.sum() / max(np.abs(part).sum(), 1e-30)),
            }
        )
    return rows


def errors(
    scene: str, side: int, tolerances: Sequence[float]
) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Acquire a scene by either method; yield a row of errors, and rows of leaves, for each run."""
    made = recorded(scene, side)
    matrix = np.asarray(made.dense(0), np.float64)
    patterns = pictures(matrix, side)
    truth = patterns @ matrix.T
    rig = rfpipe.OperatorRig(matrix, (side, side), (side, side))
    for method, tolerance in product(("symmetric", "dual"), tolerances):
        if method == "symmetric" and not made.coaxial:
            continue
        run = {"scene": scene, "side": side, "method": method, "tolerance": tolerance}
        result = rfpipe.acquire(rig, method, tolerance=tolerance, progress=False)
        lit = patterns.astype(np.float32).reshape(-1, side, side)
        images = result.transport.relight_batch(lit).reshape(truth.shape)
        values = [relative_rms(*pair) for pair in zip(images, truth, strict=True)]
        counts = {
            "patterns": result.patterns,
            "mean": float(np.mean(values)),
            "large": float(np.mean(values[:-_SMALL])),
            "worst": float(max(values)),
        }
        hierarchical = isinstance(result.transport, HierarchicalTransport)
        leaves = by_leaf(result.transport, matrix) if hierarchical else []
        yield run | counts, [run | row for row in leaves]


def append(path: Path, rows: list[dict[str, Any]]) -> None:
    """Add rows to a table."""
    if rows:
        path.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(rows).to_csv(path, mode="a", header=not path.exists(), index=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES, choices=WORLDS, metavar="SCENE")
    parser.add_argument("--side", type=int, default=48, help="pixels; 48")
    parser.add_argument("--tolerances", nargs="+", type=float, default=TOLERANCES)
    arguments = parser.parse_args()
    for scene in arguments.scenes:
        for row, leaves in errors(scene, arguments.side, arguments.tolerances):
            print(row, flush=True)
            append(OUTPUT / "tolerance.csv", [row])
            append(OUTPUT / "tolerance_leaves.csv", leaves)


if __name__ == "__main__":
    main()
