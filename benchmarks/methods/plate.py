"""Plate of hard scenes: ``python -m benchmarks.methods.plate docs/images/hard_light.png``.

A picture of each scene, relit by `auto` at 1 % and by dual photography with about as many patterns,
beside the truth. The tolerance of dual photography is the one in docs/benchmark/acquisitions.csv
whose number of patterns is nearest.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import rfpipe
from benchmarks.methods.cases import CAMERAS, newest
from benchmarks.methods.measure import CountingRig
from benchmarks.methods.scenes import stage_of
from rfpipe.report.drawing import Panel, difference, draw

_ACQUISITIONS = Path(__file__).parents[2] / "docs" / "benchmark" / "acquisitions.csv"
_SCENES = (
    "glass_and_ring", "mirror_beside", "bottle", "right_angles", "glossy_metal", "venetian_blind",
)  # fmt: skip
_SIDE, _SAMPLES, _LIGHT, _SEED = "48", 16384, "full", 1
_PICTURE = 3  # of the relit pictures: shapes that light about a third of the rays


def row_of(name: str, cache: Path) -> list[Any]:
    """Acquire a scene by both methods, and return a row of the plate."""
    stage = stage_of(name, _SIDE, 1, _SAMPLES, _SEED, cache)
    truth = stage.truth[_PICTURE]
    white = float(np.percentile(truth, 99))
    row: list[Any] = [Panel(truth, "truth", name, white)]

    def relit_by(method: str, **options: float) -> int:
        rig = CountingRig(stage.scene, CAMERAS[_LIGHT], _SEED)
        result = rfpipe.acquire(rig, method, progress=False, **options)
        errors, _ = stage.errors(result.transport.relight_batch(stage.patterns))
        relit = result.transport.relight(stage.patterns[_PICTURE]).reshape(truth.shape)
        below = f"{rig.pictures} pictures, error {100 * np.mean(errors):.2g} %"
        row.extend([Panel(relit, method, below, white), difference(relit, truth, white)])
        return result.patterns

    patterns = relit_by("auto", target_error=0.01)
    relit_by("dual", tolerance=nearest(name, patterns))
    return row


def nearest(name: str, patterns: int) -> float:
    """Return the tolerance with which dual photography took about as many patterns."""
    rows = newest(_ACQUISITIONS)
    rows = rows[(rows["method"] == "dual") & (rows["status"] == "done") & (rows["scene"] == name)]
    rows = rows[(rows["side"] == _SIDE) & (rows["light"] == _LIGHT) & (rows["seed"] == _SEED)]
    return float(rows.loc[np.abs(np.log(rows["patterns"] / patterns)).idxmin(), "value"])


def main() -> None:
    """Draw the plate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"))
    given = parser.parse_args()
    rows = [row_of(name, given.cache) for name in _SCENES]
    draw(rows, 1.5).savefig(given.file, dpi=110)


if __name__ == "__main__":
    main()
