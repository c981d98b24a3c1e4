"""The page of plots: error against patterns on each scene, estimates against truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from benchmarks.methods.cases import method_of, path_of

from rfpipe.report.drawing import (
    draw_method,
    logarithmic,
    logarithmic_limits,
    new_figure,
    png,
    scene_curves,
    shared_legend,
)
from rfpipe.report.methods import style
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["write_plots"]


def write_plots(folder: Path, summary: pd.DataFrame) -> list[str]:
    """Draw each section, light and size; return the names of the files, relative to the folder."""
    names = []
    by = ["section", "light", "side"]
    for (section, light, side), rows in summary.groupby(by, sort=False):
        done = rows[rows["ended"] > 0]
        if len(done):
            names.append(f"errors_{section}_{light}_{side}.png".replace(" ", "_"))
            write_atomically(folder / names[-1], _curves(done))
    known = summary.dropna(subset=["ratio"])
    if len(known):
        names.append("estimates.png")
        write_atomically(folder / names[-1], _estimates(known))
    return names


def _curves(rows: pd.DataFrame) -> bytes:
    """Draw mean errors against patterns, a panel a scene; dotted, a photograph's own noise."""

    def draw(axis: Axes, scene: str) -> None:
        own = rows[rows["scene"] == scene]
        for method, each in own.groupby("method", sort=True):
            ordered = each.sort_values("patterns")
            draw_method(axis, ordered["patterns"], 100 * ordered["error_mean"], str(method))
            colour = style(path_of(str(method)))["color"]
            axis.plot(ordered["patterns"], 100 * ordered["error_mean"], linestyle="none",
                      marker=".", markersize=4, color=colour)  # fmt: skip
        axis.axhline(100 * own["photo_mean"].mean(), color="#888888", linestyle=":",
                     linewidth=1, label="a photograph's noise")  # fmt: skip

    titles = {scene: scene.replace("_", " ") for scene in dict.fromkeys(rows["scene"])}
    return png(scene_curves(titles, draw, rows["patterns"], rows["error_mean"]))


def _estimates(rows: pd.DataFrame) -> bytes:
    """Draw estimated errors against true ones: filled where scene and seed are open."""
    methods = [name for name in dict.fromkeys(rows["method"]) if method_of(name).estimates_error]
    figure, axes = new_figure(1, len(methods), (4 * len(methods), 4))
    ends = 100 * np.array(logarithmic_limits([*rows["error_mean"], *rows["estimated_error"]]))
    for axis, method in zip(axes[0], methods, strict=True):
        own = rows[rows["method"] == method]
        look = style(path_of(method))
        for section, each in own.groupby("section", sort=True):
            face = look["color"] if section == "open" else "white"
            axis.plot(100 * each["error_mean"], 100 * each["estimated_error"], linestyle="none",
                      marker=look["marker"], color=look["color"], markerfacecolor=face,
                      markersize=5, label=section)  # fmt: skip
        axis.plot(ends, ends, color="#888888", linewidth=0.8, label="equal")
        logarithmic(axis)
        axis.set(xlim=ends, ylim=ends)
        axis.set_title(method_of(method).title, fontsize=9)
        axis.set_xlabel("true mean error, %", fontsize=8.5)
        axis.set_ylabel("estimated, %", fontsize=8.5)
    shared_legend(figure)
    return png(figure)
