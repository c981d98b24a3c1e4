"""Figs. 2.1, 5.7 and 5.9 of the scenes that a run acquired: ``python -m figures planes OUT``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm

from figures.common import Items, Picture, Size, error, percent, with_errors
from rfpipe.report.drawing import UNLIT_GAIN, Map, Panel, difference, draw, unlit_gain
from rfpipe.stages.relight import NO_LEAF, right_half
from rfpipe.store import open_arrays, read_manifest

_DECADES = 7  # of the matrix' entries, from the largest of a scene down
_BRIGHT = 0.7  # of white, where the dark half's brightest light is shown
_ROWS = ("(a) albedo", "(b) T x floodlight", "(c) T along a row", "true T",
         "(d) level of the leaf", "(e) T x vertical bar", "true radiance", "")  # fmt: skip
_MATRICES = (
    "the matrices are symmetric; a flat diffuse plane's is diagonal; light from one plane to "
    "another is smooth, and texture scales its rows and columns alone."
)
_LEVELS = (
    "stopped at any level, the picture has full resolution, but the pattern's light is spread over "
    "each block that it touches."
)
_METHODS = (
    "symmetric photography resolves the fine texture in indirect light with 841 patterns, dual "
    "photography blurs it with 7,382."
)


class Acquired:
    """A scene acquired by a method, relit, in the run's folder ``results``."""

    def __init__(self, manifest: Path) -> None:
        self.facts: dict[str, Any] = read_manifest(manifest)
        self.scene, self.method = manifest.parts[-3:-1]
        images = open_arrays(manifest.with_suffix(".zarr"))
        self.images = {name: images.read(name) for name in images.names}
        self.white = float(self.images["floodlit_truth"].max()) or 1.0

    def compared(self, name: str, gain: Any, index: Any = ...) -> tuple[Panel, Panel, Map]:
        """Return a picture as relit, as it truly is, and the difference."""
        relit, truth = (self.images[f"{name}{of}"][index] for of in self._of(name))
        below = f"error {percent(error(relit, truth))}"
        return (Panel(relit, "relit", below, self.white, gain),
                Panel(truth, "ground truth", "", self.white, gain),
                difference(relit, truth, self.white, gain))  # fmt: skip

    @staticmethod
    def _of(name: str) -> tuple[str, str]:
        return ("_relit", "_truth") if name else ("relit", "truth")


def items(_size: Size) -> Items:
    """Draw the coaxial scenes of a single view."""
    rows = []
    for path in sorted(Path("results").glob("*/*/relight.json")):
        is_drawn = "line_truth" in open_arrays(path.with_suffix(".zarr")).names
        if is_drawn and read_manifest(path)["coaxial"]:
            rows.append(Acquired(path))
    for method in dict.fromkeys(run.method for run in rows):
        runs = [run for run in rows if run.method == method]
        yield _matrices(method, runs)
        if len(runs[-1].images["levels_relit"]) > 1:
            yield _levels(method, runs[-1])
    for scene in dict.fromkeys(run.scene for run in rows):
        yield from _methods(scene, [run for run in rows if run.scene == scene])


def _matrices(method: str, runs: list[Acquired]) -> Picture:
    rows = dict(zip(_ROWS, zip(*map(_column, runs), strict=True), strict=True))
    if not all("line_levels" in run.images for run in runs):
        del rows["(d) level of the leaf"]
    caption = (
        "T says how much light each projector ray, a column, sends into each camera ray, a row. "
        f"(c) Entries between the rays of the middle row, over {_DECADES} decades; the diagonal is "
        "direct light. (d) Level of the leaf that holds each entry; pale blue none. (e) Unlit "
        f"pixels {UNLIT_GAIN} times brighter; below it the truth, and the difference."
    )
    figure = draw([*rows.values()], labels=[*rows])
    return Picture(f"fig_2_1_{method}", f"Fig. 2.1, {method}", _MATRICES, caption, figure)


def _column(run: Acquired) -> list[Any]:
    """Return a run's panels, top to bottom."""
    albedo = Panel(run.images["albedo"], run.scene)
    panels = [albedo, run.compared("floodlit", 1.0)[0]]
    top = float(run.images["line_truth"].mean(axis=-1).max())
    for name in ("line_relit", "line_truth"):
        share = np.maximum(run.images[name].mean(axis=-1) / top, 10.0**-_DECADES)
        grey = {"cmap": "magma", "norm": LogNorm(10.0**-_DECADES, 1)}
        panels.append(Map(share, "", "projector ray", "entry of T over the largest", grey))
    levels = np.ma.masked_equal(run.images.get("line_levels", [[NO_LEAF]]), NO_LEAF)
    shades = {"cmap": "gray_r", "vmin": 0, "vmax": run.facts["levels"][-1]["level"]}
    panels.append(Map(levels, "", "projector ray", "level", shades))
    return [*panels, *run.compared("", unlit_gain(run.images["patterns"][0]), 0)]


def _levels(method: str, run: Acquired) -> Picture:
    truth, patterns, panels = run.images["truth"][0], 0, []
    for row, image in zip(run.facts["levels"], run.images["levels_relit"], strict=True):
        if row["patterns"]:
            patterns += row["patterns"]
            below = f"patterns {patterns:,}, error {percent(error(image, truth))}"
            panels.append(Panel(image, f"level {row['level']}", below, run.white))
    caption = f"{run.scene} relit with the vertical bar, and below the difference from the truth."
    figure = draw(with_errors(panels, Panel(truth, "ground truth", "", run.white)))
    return Picture(f"fig_5_7_{method}", f"Fig. 5.7, {method}", _LEVELS, caption, figure)


def _methods(scene: str, runs: list[Acquired]) -> Iterator[Picture]:
    """Draw indirect light on the left half when the right one is lit, if there is any."""
    half = runs[0].images["half_truth"]
    dark = right_half(half.shape[:2]) == 0
    brightest = float(np.percentile(half[dark], 99))
    if len(runs) == 1 or not brightest:
        return
    gain = unlit_gain(~dark, _BRIGHT * runs[0].white / brightest)
    panels = []
    for run in runs:
        off = percent(error(run.images["half_relit"], half, dark))
        below = f"patterns {run.facts['patterns']:,}, error {off}"
        panels.append(Panel(run.images["half_relit"], run.method, below, run.white, gain))
    truth = Panel(half, "ground truth", "", runs[0].white, gain)
    caption = (
        f"The right half is lit; the left one shows indirect light alone, {gain.max():.0f} times "
        "brighter; its relative RMS error on that half, and the difference from the truth."
    )
    figure = draw(with_errors(panels, truth, len(runs) + 1))
    yield Picture(f"fig_5_9_{scene}", f"Fig. 5.9, {scene}", _METHODS, caption, figure)
