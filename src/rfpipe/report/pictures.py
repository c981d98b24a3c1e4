"""Relit pictures side by side [thesis Figs. 5.7, 5.9 and B.1]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.report import methods
from rfpipe.report.drawing import (
    brighten_unlit,
    label_below,
    label_left,
    new_figure,
    panel_ratio,
    show_radiance,
)
from rfpipe.report.inputs import Run, Study
from rfpipe.report.text import TIMES
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms
from rfpipe.stages.relight import right_half

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["amplification", "levels_figure", "methods_figure", "mosaic_figure"]

_PANEL = 2.2  # inches
_BRIGHT = 0.7  # of white: where the dark half's brightest light is amplified to


def amplification(run: Run) -> float:
    """Return the round factor that makes the unlit half of [Fig. 5.9] well visible."""
    dark = right_half(run.settings.shape) == 0
    brightest = float(np.percentile(run.read("half_truth")[dark], 99))
    wanted = _BRIGHT * run.white / brightest if brightest > 0 else 1.0
    magnitude = 10.0 ** np.floor(np.log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * magnitude <= wanted) * magnitude)


def methods_figure(scenes: Sequence[Sequence[Run]]) -> Figure:
    """Compare methods by the light that the lit right half sends to the left one [Fig. 5.9].

    Parameters
    ----------
    scenes : sequence of sequences of Run
        For each scene with indirect light its runs. A method that some scenes weren't acquired
        with leaves its panel empty there.
    """
    shown = list(dict.fromkeys(run.method for runs in scenes for run in runs))
    ratio = panel_ratio([runs[0].image_shape for runs in scenes])
    columns = len(shown) + 1
    panel = _PANEL * (1.25 if columns < 4 else 1.1)
    size = (panel * columns + 0.5, (panel * ratio + 0.52) * len(scenes))
    figure, axes = new_figure(len(scenes), columns, size)
    for row, runs in zip(axes, scenes, strict=True):
        gain = amplification(runs[0])
        pattern = right_half(runs[0].settings.shape)
        truth = runs[0].read("half_truth")
        for axis, method in zip(row, shown, strict=False):
            run = next((run for run in runs if run.method == method), None)
            if run is None:
                axis.set_axis_off()
                continue
            relit = run.read("half_relit")
            show_radiance(axis, brighten_unlit(relit, pattern, gain), run.white)
            error = unlit_rms(relit, truth, pattern)
            label_below(axis, f"patterns {run.patterns:,}\nerror on the left half {error:.1%}")
        show_radiance(row[-1], brighten_unlit(truth, pattern, gain), runs[0].white)
        label_below(row[-1], f"left half {TIMES} {gain:g}")
        row[0].text(-0.06, 0.5, runs[0].title, rotation=90, ha="right", va="center", fontsize=8.5,
                    transform=row[0].transAxes)  # fmt: skip
    for axis, name in zip(axes[0], [*map(methods.title, shown), "Ground truth"], strict=True):
        axis.set_title(name, fontsize=9.5, pad=5)
    return figure


def levels_figure(runs: Sequence[Run]) -> Figure:
    """Relight the vertical bar as if the acquisition had stopped at each level [Fig. 5.7].

    Parameters
    ----------
    runs : sequence of Run
        Of one scene, the methods that have levels. Those without patterns are left out.
    """
    ratio = panel_ratio([runs[0].image_shape])
    per_row = 5
    n_levels = max(sum(row["patterns"] > 0 for row in run.facts["levels"]) for run in runs)
    rows_each = -(-(n_levels + 1) // per_row)
    panel = 2.05
    size = (panel * per_row + 0.5, (panel * ratio + 0.42) * rows_each * len(runs))
    figure, axes = new_figure(rows_each * len(runs), per_row, size)
    for index, run in enumerate(runs):
        own = axes[index * rows_each : (index + 1) * rows_each]
        label_left(own[0, 0], run.method_title)
        truth = run.read_shown("truth")[0]
        shown, panel_of = 0, iter(own.flat)
        for row, image in zip(run.facts["levels"], run.read_shown("levels_relit"), strict=True):
            if not row["patterns"]:
                continue
            axis = next(panel_of)
            show_radiance(axis, image, run.white)
            axis.set_title(f"level {row['level']}", fontsize=8.5, pad=3)
            shown += int(row["patterns"])
            label_below(axis, f"patterns {shown:,}, error {relative_rms(image, truth):.1%}")
        axis = next(panel_of)
        show_radiance(axis, truth, run.white)
        axis.set_title("ground truth", fontsize=8.5, pad=3)
        for unused in panel_of:
            unused.set_axis_off()
    return figure


def mosaic_figure(study: Study) -> Figure:
    """Show the sum of single-pixel images before and after normalization [Fig. B.1]."""
    chains = list(dict.fromkeys(row["chain"] for row in study.rows))
    modes = list(dict.fromkeys(row["normalization"] for row in study.rows))
    ratio = panel_ratio([study.images.shape(f"floodlit_{chains[0]}")])
    panel = 2.4
    size = (panel * (len(modes) + 1) + 0.5, (panel * ratio + 0.62) * len(chains))
    figure, axes = new_figure(len(chains), len(modes) + 1, size)
    names = {
        "none": "sum of all images",
        "per_channel": "normalized per channel",
        "total_energy": "normalized by total energy",
    }
    for row, chain in zip(axes, chains, strict=True):
        floodlit = study.images.read(f"floodlit_{chain}")
        white = float(floodlit.max())
        show_radiance(row[0], floodlit, white)
        label_left(row[0], _CHAINS[chain])
        for axis, mode in zip(row[1:], modes, strict=True):
            show_radiance(axis, study.images.read(f"sum_{chain}_{mode}"), white)
            facts = next(
                fact
                for fact in study.rows
                if (fact["chain"], fact["normalization"]) == (chain, mode)
            )
            label_below(
                axis, f"light {facts['energy']:.0%}, colour contrast {facts['colour_contrast']:.0%}"
            )
    for axis, title in zip(axes[0], ["floodlit", *(names[mode] for mode in modes)], strict=True):
        axis.set_title(title, fontsize=9.5, pad=5)
    return figure


_CHAINS = {
    "linear": "whole bracket,\nlinear interpolation",
    "median": "one short exposure,\nmedian interpolation",
}
