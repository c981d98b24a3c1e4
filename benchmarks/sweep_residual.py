"""What the constants behind the estimate of what a model leaves do (`rfpipe.methods.residual`).

Usage: ``python benchmarks/sweep_residual.py [--side N] [--cache FOLDER] [SCENE ...]``, by default
the open scenes of coaxial rigs in the open benchmark, 48 x 48 (a quarter of an hour, and the time
to record their light). Of each scene: smooth light fitted to 36 probes, and what it leaves to
these and 40 block patterns, all through the default camera; then again with one constant changed.
Errors are means over the benchmark's relit pictures. Writes results/bench/sweep_residual.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from benchmarks.methods.scenes import Stage, stage_of
from numpy.typing import NDArray
from tqdm import tqdm

from rfpipe.methods.near_far.beyond import all_pictures, canvas_of, cells_of
from rfpipe.methods.near_far.model import Model, fit
from rfpipe.methods.near_far.patterns import block_patterns, probe_patterns
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.near_far.transport import as_transport
from rfpipe.methods.residual import estimate as estimating
from rfpipe.methods.residual import fit as fitting
from rfpipe.methods.residual import pictures as canvases
from rfpipe.methods.residual import prior as priors
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.merging.merger import Merger
from rfpipe.transport.sum import SumTransport

OUTPUT = Path("results/bench/sweep_residual.csv")
SCENES = ("two_blocks", "red_wall_box", "foreshortened", "translucent", "wedge_30", "wedge_iii")
SWEPT: tuple[tuple[str, Any, tuple[float, ...]], ...] = (
    ("_CLIPPED", estimating, (0, 2, 4, 8, 16)),
    ("_EXPECTED", estimating, (1e-4, 2.5e-4, 5e-4, 1e-3, 2e-3)),
    ("_LEARNED", estimating, (0, 1, 2, 4)),
    ("_ITERATIONS", estimating, (4, 8, 16)),
    ("_DROPPED", estimating, (3e-4, 5e-4, 1e-3, 3e-3)),
    ("_DIRECT", fitting, (0.002, 0.02, 0.2)),
    ("_REACH", priors, (0.125, 0.25, 0.5, 1.0, 2.0, 8.0)),
    ("_LIFTED", canvases, (0.005, 0.02, 0.08)),
    ("_EXPONENT", canvases, (0.25, 0.5, 0.75, 1.0)),
)
_PROBES = (6, 10, 8, 12)  # of the first rounds, which have no bands yet
_BLOCKS = 40
_BLACK, _FLOODLIT = 8, 64

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Taken:
    """A scene's pictures, and the smooth light found from its probes.

    Attributes
    ----------
    stage : Stage
    probes : Pictures
    blocks : Pictures
    model : Model
    """

    stage: Stage
    probes: Pictures
    blocks: Pictures
    model: Model

    @classmethod
    def of(cls, stage: Stage) -> Taken:
        """Show probes and blocks, and fit smooth light to the former."""
        shape = stage.scene.projector_shape
        rounds = [
            probe_patterns(shape, level, count) for level, count in enumerate(_PROBES, start=1)
        ]
        shown = np.concatenate([*rounds, block_patterns(cells_of(shape), len(_PROBES), _BLOCKS)])
        pictures = photographed(stage, shown)
        count = sum(_PROBES)
        probes = Pictures(
            pictures.floodlit,
            pictures.floodlit_variance,
            pictures.lit[:count],
            pictures.radiance[:count],
            pictures.variance[:count],
        )
        return cls(stage, probes, pictures.since(count), fit(shape, probes))

    def error(self) -> float:
        """Estimate what smooth light leaves; return the mean error of relit pictures."""
        shape = self.stage.scene.projector_shape
        canvas = canvas_of(shape, self.probes)
        blocks = canvas.taken(self.blocks.lit, self.blocks.radiance, self.blocks.variance)
        smooth = self._transport()
        left = estimating.estimate(canvas, all_pictures(canvas, self.probes, blocks), smooth)
        return self._compared(self._transport([(left.transport(canvas), 0)]))

    def smooth_error(self) -> float:
        """Return the mean error of pictures that are relit by smooth light alone."""
        return self._compared(self._transport())

    def _transport(self, more: Any = ()) -> SumTransport:
        shape = self.stage.scene.projector_shape
        return as_transport(shape, [], self.model, self.probes, 0, more)

    def _compared(self, transport: SumTransport) -> float:
        relit = transport.relight_batch(np.stack(list(self.stage.patterns.values())))
        pairs = zip(relit, self.stage.truth, strict=True)
        return float(np.mean([relative_rms(one, truth) for one, truth in pairs]))


def photographed(stage: Stage, lit: NDArray[np.bool_]) -> Pictures:
    """Take pictures of patterns (M, *shape) through the default camera."""
    scene = stage.scene
    rig = SimulatedRig(scene, CameraModel(), seed=1)
    shape = scene.projector_shape

    def brackets(patterns: Any, first: int) -> Iterator[NDArray[Any]]:
        for index, pattern in enumerate(patterns):
            yield rig.capture(np.asarray(pattern[None], np.float32), [(first, index)])

    merger = Merger.from_references(
        rig.sensor,
        brackets(np.zeros((_BLACK, *shape)), 0),
        brackets(np.ones((_FLOODLIT, *shape)), 1),
        saturation_fraction=0.98,
        mask_defects=True,
    )
    merged = [merger.merge(frames, index) for index, frames in enumerate(brackets(lit, 2))]
    radiance, variance = (
        np.concatenate([getattr(each, name) for each in merged])
        for name in ("radiance", "variance")
    )
    return Pictures(
        *(_planes(each[None])[0] for each in (merger.floodlit, merger.floodlit_variance)),
        lit.reshape(len(lit), -1),
        _planes(radiance),
        _planes(variance),
    )


def _planes(images: NDArray[Any]) -> Float:
    """Return images (B, *shape, C) as (B, C, N)."""
    flat = images.reshape(len(images), -1, images.shape[-1])
    return np.ascontiguousarray(np.moveaxis(flat, 1, 2), np.float32)


def changed(module: Any, name: str, value: float) -> AbstractContextManager[Any]:
    """Set a constant, which keeps its type, for a while; nothing where it has that value."""
    standing = getattr(module, name)
    if standing == value:
        return nullcontext()
    return patch.object(module, name, type(standing)(value))


def main() -> None:
    """Sweep, and print a table of errors in per cent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--side", type=int, default=48, help="pixels, 16 to 64")
    parser.add_argument("--cache", type=Path, default=Path("results/recorded"))
    asked = parser.parse_args()
    rows: list[dict[str, object]] = []
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    runs = [(name, module, value) for name, module, values in SWEPT for value in values]
    for scene in asked.scenes:
        taken = Taken.of(stage_of(scene, asked.side, 1, 16384, 1, asked.cache))
        smooth = taken.smooth_error()
        rows.append({"scene": scene, "constant": "smooth light alone", "error": smooth})
        standing: float | None = None
        for name, module, value in tqdm(runs, desc=scene):
            is_standing = getattr(module, name) == value
            began = perf_counter()
            if not is_standing or standing is None:
                with changed(module, name, value):
                    error = taken.error()
            if is_standing:
                standing = error = error if standing is None else standing
            rows.append(
                {
                    "scene": scene,
                    "constant": name,
                    "value": value,
                    "standing": is_standing,
                    "error": error,
                    "seconds": perf_counter() - began,
                }
            )
            pd.DataFrame(rows).to_csv(OUTPUT, index=False)
    table = pd.DataFrame(rows).fillna({"value": 0})
    table["error"] *= 100
    order = list(dict.fromkeys(zip(table["constant"], table["value"], strict=True)))
    found = table.pivot_table(index=["constant", "value"], columns="scene", values="error")
    print(found.reindex(order)[list(asked.scenes)].round(2).to_string())


if __name__ == "__main__":
    main()
