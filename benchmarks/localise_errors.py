"""Errors of symmetric and dual photography against their tolerance, in exact radiance.

Usage: ``python benchmarks/localise_errors.py [SCENE ...]``, scenes of Mitsuba by name, by default a
box with two blocks and one with a red wall (needs ``rfpipe[mitsuba]``; half an hour). Their light
is recorded at 48 x 48 with 16,384 samples, the red channel is acquired. For symmetric photography
the error of half-lit pictures is told apart by the kind and the level of the leaves that hold it.
Writes results/bench/tolerance.csv and results/bench/tolerance_leaves.csv.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import rfpipe
from rfpipe.scenes.kinds.mitsuba import Mitsuba, MitsubaOptions
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.transport.hierarchical.transport import HierarchicalTransport

OUTPUT = Path("results/bench")
SCENES = ("two_blocks", "red_wall_box")
SHAPE = (48, 48)
TOLERANCES = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
_KINDS = ("empty", "scalar", "rank 1", "rank k")
_CREASE = 0.02  # of the pixels
_HALF_LIT = 8  # random pictures to localise errors by

Array = NDArray[np.float64]


def recorded(scene: str) -> Array:
    """Return the red channel of a scene's recorded matrix, (N, N)."""
    options = MitsubaOptions(
        kind="rfpipe.scenes.kinds.mitsuba:Mitsuba", scene=scene, shape=SHAPE, samples=16384
    )
    return np.asarray(Mitsuba.make(options).dense(0), np.float64)


def pictures(matrix: Array) -> Array:
    """Return the relighting patterns, three small spots, a crease and a half-lit one, (P, N)."""
    height, width = SHAPE
    found = list(relighting_patterns(SHAPE).values())
    random = np.random.default_rng(5)
    for side in (1, 2, 3):
        top, left = random.integers(0, height - side), random.integers(0, width - side)
        found.append(np.zeros(SHAPE, np.float32))
        found[-1][top : top + side, left : left + side] = 1
    found.append(_crease(matrix).astype(np.float32))
    found.append(np.broadcast_to(np.arange(width) < width // 2, SHAPE).astype(np.float32))
    return np.stack(found).reshape(len(found), -1).astype(np.float64)


def _crease(matrix: Array) -> NDArray[np.bool_]:
    """Pixels that exchange most light with their neighbours, (H, W)."""
    height, width = SHAPE
    near, rays = np.zeros(height * width), np.arange(height * width).reshape(SHAPE)
    for down, right in ((0, 1), (1, 0), (1, 1)):
        one, other = rays[: height - down, : width - right].ravel(), rays[down:, right:].ravel()
        near[one] += matrix[one, other]
        near[other] += matrix[one, other]
    return (near >= np.quantile(near, 1 - _CREASE)).reshape(SHAPE)


def by_leaf(transport: HierarchicalTransport, matrix: Array) -> list[dict[str, Any]]:
    """Tell the error of random half-lit pictures apart by kind, level and place of leaves."""
    tree, rays = transport.tree, len(matrix)
    order = tree.order
    unit = np.eye(rays, dtype=np.float32).reshape(rays, *SHAPE)
    error = transport.relight_batch(unit).reshape(rays, rays).T - matrix
    error, truth = error[np.ix_(order, order)], matrix[np.ix_(order, order)]
    kind, level = np.zeros((rays, rays), np.int8), np.full((rays, rays), -1, np.int8)
    on_diagonal = np.zeros((rays, rays), np.bool_)
    for leaves in transport.leaf_sets:
        pairs, terms = np.unique(
            np.stack([leaves.block_a, leaves.block_b]), axis=1, return_counts=True
        )
        starts, scalar = tree.starts[leaves.level], leaves.level == tree.n_levels - 1
        for a, b, count in zip(*pairs, terms, strict=True):
            for one, other in ((a, b), (b, a)):
                place = (
                    slice(starts[one], starts[one + 1]),
                    slice(starts[other], starts[other + 1]),
                )
                kind[place] = 1 if scalar else 2 + (count > 1)
                level[place], on_diagonal[place] = leaves.level, a == b
    lit = np.random.default_rng(0).integers(0, 2, (rays, _HALF_LIT)).astype(np.float64)
    norm = np.linalg.norm(truth @ lit)
    rows = []
    for which in np.unique(np.stack([kind.ravel(), level.ravel(), on_diagonal.ravel()]), axis=1).T:
        here = (kind == which[0]) & (level == which[1]) & (on_diagonal == which[2])
        part = np.where(here, error, 0.0)
        rows.append(
            {
                "kind": _KINDS[which[0]],
                "level": int(which[1]),
                "diagonal": bool(which[2]),
                "area": float(here.mean()),
                "half_lit_error": float(np.linalg.norm(part @ lit) / norm),
                "of_one_sign": float(part.sum() / max(np.abs(part).sum(), 1e-30)),
            }
        )
    return rows


def main() -> None:
    errors, leaves = [], []
    for scene in sys.argv[1:] or SCENES:
        matrix = recorded(scene)
        patterns = pictures(matrix)
        truth = patterns @ matrix.T
        rig = rfpipe.OperatorRig(matrix, SHAPE, SHAPE)
        for method in ("symmetric", "dual"):
            for tolerance in TOLERANCES:
                run = {"scene": scene, "method": method, "tolerance": tolerance}
                result = rfpipe.acquire(rig, method, tolerance=tolerance, progress=False)
                lit = patterns.astype(np.float32).reshape(-1, *SHAPE)
                images = result.transport.relight_batch(lit).reshape(truth.shape)
                found = [relative_rms(*pair) for pair in zip(images, truth, strict=True)]
                counts = {"patterns": result.patterns, "mean": np.mean(found), "worst": max(found)}
                errors.append({**run, **counts})
                print(errors[-1], flush=True)
                if isinstance(result.transport, HierarchicalTransport):
                    leaves += [{**run, **row} for row in by_leaf(result.transport, matrix)]
    OUTPUT.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(errors).to_csv(OUTPUT / "tolerance.csv", index=False)
    pd.DataFrame(leaves).to_csv(OUTPUT / "tolerance_leaves.csv", index=False)


if __name__ == "__main__":
    main()
