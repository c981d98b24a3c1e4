"""Fig. 3.8: patterns against the projector's resolution, of the box, the bottle and scene IV."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from figures.common import (
    TOLERANCE,
    Items,
    Picture,
    Size,
    Table,
    acquired,
    aside,
    error,
    physical,
    seen,
    white,
)
from rfpipe import acquire
from rfpipe.array_types import Float
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.report.drawing import new_figure
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene

_SIZES = 5
_COLOURS = {"box": "#c4611a", "bottle": "#3a6fb0", "dual": "#c4611a", "symmetric": "#1f5a9e"}


@dataclass(frozen=True)
class _Coarse:
    """A scene before a projector of larger pixels, each `factor` of the scene's along a side."""

    scene: Any
    factor: int

    def __getattr__(self, name: str) -> Any:
        return getattr(self.scene, name)

    @property
    def projector_shape(self) -> tuple[int, int]:
        """Larger pixels; the camera stays as it is, as the thesis' did."""
        height, width = self.scene.projector_shape
        return height // self.factor, width // self.factor

    def apply(self, patterns: Float) -> Float:
        """Radiance (B, M, C) under patterns (B, N)."""
        coarse = patterns.reshape(len(patterns), *self.projector_shape)
        fine: Float = coarse.repeat(self.factor, 1).repeat(self.factor, 2)
        radiance: Float = self.scene.apply(fine.reshape(len(patterns), -1))
        return radiance


def items(size: Size) -> Items:
    """Acquire box and bottle at five resolutions of the projector, scene IV at the given ones."""
    scenes = {
        "box": aside(size, "two_blocks", shape=size.even),
        "bottle": physical(size, "bottle", shape=size.even),
    }
    rows, levels = zip(
        *(
            _acquired_at(name, _Coarse(scene, 2**halvings))
            for name, scene in scenes.items()
            for halvings in reversed(range(min(_SIZES, int(np.log2(scene.projector_shape[0])))))
        ),
        strict=True,
    )
    numbers = pd.DataFrame(rows)
    fits = pd.DataFrame(
        [
            {"scene": name, **line_fit(scene_rows)}
            for name, scene_rows in numbers.groupby("scene", sort=False)
        ]
    )
    summary = "; ".join(
        f"{row.scene}: {row.slope:.0f} patterns a level, the line explains {row.explained:.0%}, "
        f"the exponent of pixels is {row.exponent:.2f}"
        for row in fits.itertuples()
    )
    caption = (
        f"{summary}. Left, pixels on a logarithmic scale: growth as O(log pq) is a straight line, "
        "dashed the one fitted. Right, both logarithmic, with brute force: an exponent of 0 is "
        "logarithmic growth, 1 is brute force."
    )
    thesis = (
        "patterns grow with the logarithm of the projector's resolution, for the box and the "
        "bottle."
    )
    figure = _curves(numbers, "scene", fits)
    yield Picture("fig_3_8_physical", "Fig. 3.8", thesis, caption, figure)
    yield Table("growth", "Patterns by resolution", "As measured.", numbers)
    yield Table("growth_fits", "Lines fitted to them", "Slope in patterns a level.", fits)
    caption = "Blocks of each level, and the patterns that light them."
    yield Table("growth_levels", "Where the patterns go", caption, pd.concat(levels))
    flat = pd.DataFrame([row for side in size.sides for row in _scene_iv(side)])
    caption = "Scene IV in grey, exact radiance, its texture as fine as the pixels at each size."
    yield Picture("fig_3_8", "Fig. 3.8, scene IV", thesis, caption, _curves(flat, "method"))
    yield Table("resolution", "Patterns of scene IV", "Error: of a bar of light.", flat)


def _acquired_at(name: str, coarse: _Coarse) -> tuple[dict[str, Any], pd.DataFrame]:
    """Acquire a scene at one resolution of the projector; return its row, and one a level."""
    result, _ = acquired(coarse, "dual")
    light = white(coarse.projector_shape)
    tree = BlockTree(RayDomain(coarse.projector_shape))
    levels = pd.DataFrame(result.levels)[["level", "patterns"]]
    levels = levels.assign(scene=name, side=coarse.projector_shape[0])
    levels["blocks"] = [tree.n_blocks(int(level)) for level in levels["level"]]
    row = {
        "scene": name,
        "side": coarse.projector_shape[0],
        "rays": light.size,
        "levels": tree.n_levels,
        "patterns": result.patterns,
        "error": error(result.transport.relight(light), seen(coarse, light)),
    }
    return row, levels


def _scene_iv(side: int) -> list[dict[str, Any]]:
    scene = reference_scene("IV", (side, side), channels=1)
    bar = np.zeros((side, side), np.float32)
    bar[:, side // 4 : side // 4 + max(1, side // 8)] = 1
    rows = []
    for method in ("symmetric", "dual"):
        result = acquire(SimulatedRig(scene), method, progress=False, tolerance=TOLERANCE)
        off = error(result.transport.relight(bar), seen(scene, bar))
        rows.append({"method": method, "side": side, "rays": side**2, "error": off,
                     "patterns": result.patterns})  # fmt: skip
    return rows


def line_fit(rows: pd.DataFrame) -> dict[str, float]:
    """Fit a line to patterns against levels, and a power law to patterns against pixels.

    Returns
    -------
    dict of str to float
        ``slope`` and ``base`` of the line, ``explained``: its share of the variance, and
        ``exponent`` of the power law.
    """
    levels, patterns = (np.asarray(rows[name], float) for name in ("levels", "patterns"))
    slope, base = np.polyfit(levels, patterns, 1)
    exponent, _ = np.polyfit(np.log(np.asarray(rows["rays"], float)), np.log(patterns), 1)
    spread = float(((patterns - patterns.mean()) ** 2).sum())
    residual = float(((patterns - base - slope * levels) ** 2).sum())
    explained = 1 - residual / spread if spread > 0 else 1.0
    line = {"slope": slope, "base": base, "explained": explained, "exponent": exponent}
    return {name: float(value) for name, value in line.items()}


def _curves(numbers: pd.DataFrame, by: str, fits: pd.DataFrame | None = None) -> Any:
    """Draw patterns against pixels, on a linear and on a logarithmic scale."""
    figure, axes = new_figure(1, 2, (8.6, 3.4))
    sides = numbers.drop_duplicates("rays").sort_values("rays")
    for axis in axes[0]:
        for name, scene_rows in numbers.groupby(by, sort=False):
            axis.plot(
                scene_rows["rays"],
                scene_rows["patterns"],
                "o-",
                color=_COLOURS[str(name)],
                label=name,
            )
        axis.set_xscale("log", base=2)
        axis.set_xticks(sides["rays"], [f"{side}²" for side in sides["side"]])
        axis.set(xlabel="projector pixels", ylabel="patterns")
        axis.grid(True, linewidth=0.4, color="#dddddd")
    for fit in () if fits is None else fits.itertuples():
        scene_rows = numbers[numbers[by] == fit.scene]
        axes[0, 0].plot(scene_rows["rays"], fit.base + fit.slope * scene_rows["levels"], "--",
                        color=_COLOURS[fit.scene], linewidth=0.9)  # fmt: skip
    axes[0, 1].plot(sides["rays"], sides["rays"], "k:", label="brute force")
    axes[0, 1].set_yscale("log")
    for axis in axes[0]:
        axis.legend(fontsize=8, frameon=False)
    return figure
