"""Pictures of a calibration's steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings
from rfpipe.report.drawing import label_below, label_left, new_figure, panel_ratio

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "correspondence_figure",
    "dark_figure",
    "light_figure",
    "linearity_figure",
    "rays_figure",
    "symmetry_figure",
    "transfer_figure",
]

_BLUE, _RED, _GREY = "#1f5a9e", "#c4611a", "#9a9a9a"
_WIDTH = 8.4
# Measurements with their error bars.
_POINTS: dict[str, Any] = {"fmt": "o", "markersize": 3, "linewidth": 0.8, "color": _BLUE}


def dark_figure(findings: Findings) -> Figure:
    """Draw the black level against exposure, and as a picture."""
    facts, black = findings.facts, findings.arrays["black"]
    figure, ((left, right),) = new_figure(1, 2, (_WIDTH, 3.0))
    times = np.array(facts["exposures_s"])
    line = facts["black_level_counts"] + facts["current_counts_per_s"] * times
    left.plot(times, facts["level_counts"], "o", color=_BLUE)
    left.plot(times, line, color=_RED, linewidth=0.9)
    left.ticklabel_format(axis="y", useOffset=False)
    label_below(left, "exposure, s")
    label_left(left, "mean without light, counts")
    longest = black[-1]
    _map(right, longest if longest.ndim == 2 else longest.mean(axis=-1), "counts")
    return figure


def linearity_figure(findings: Findings) -> Figure:
    """Draw the deviation between exposures against the level."""
    arrays = findings.arrays
    figure, ((axis,),) = new_figure(1, 1, (_WIDTH * 0.6, 3.0))
    axis.axhline(0, color=_GREY, linewidth=0.8)
    axis.errorbar(
        arrays["linearity_level"],
        100 * arrays["linearity_deviation"],
        200 * arrays["linearity_error"],
        **_POINTS,
    )
    axis.set_xscale("log")
    label_below(axis, "counts above black, fraction of full scale")
    label_left(axis, "deviation, %")
    return figure


def light_figure(findings: Findings) -> Figure:
    """Draw the projector's response."""
    arrays = findings.arrays
    codes, measured = arrays["light_codes"], arrays["light_measured"]
    figure, ((left, right),) = new_figure(1, 2, (_WIDTH, 3.0))
    every = np.arange(256)
    left.plot(every, arrays["projector_response"], color=_RED, linewidth=0.9)
    left.plot(codes, measured, "o", markersize=3, color=_BLUE)
    label_left(left, "light, fraction of code 255")
    right.plot(
        every,
        100 * (arrays["projector_response"] - (every / 255) ** 2.2),
        color=_RED,
        linewidth=0.9,
    )
    right.errorbar(
        codes,
        100 * (measured - (codes / 255) ** 2.2),
        200 * arrays["light_error"],
        **_POINTS,
    )
    label_left(right, "less gamma 2.2, %")
    for axis in (left, right):
        label_below(axis, "code")
    return figure


def transfer_figure(findings: Findings) -> Figure:
    """Draw the photon-transfer curve."""
    arrays = findings.arrays
    signal, variance, error, model = (
        arrays[f"ptc_{name}"] for name in ("signal", "variance", "error", "model")
    )
    used = arrays["ptc_used"]
    other = ~used & (signal > 0) & (variance > 0)
    figure, ((left, right),) = new_figure(1, 2, (_WIDTH, 3.2))
    left.loglog(signal[other], variance[other], "o", markersize=3, color=_GREY, fillstyle="none")
    left.loglog(signal[used], variance[used], "o", markersize=3, color=_BLUE)
    left.loglog(signal[used], model[used], color=_RED, linewidth=0.9)
    label_left(left, "variance, counts²")
    right.axhline(1, color=_RED, linewidth=0.9)
    right.errorbar(
        signal[used],
        variance[used] / model[used],
        2 * error[used] / model[used],
        **_POINTS,
    )
    right.set_xscale("log")
    label_left(right, "measured over fitted")
    for axis in (left, right):
        label_below(axis, "signal, counts")
    return figure


def correspondence_figure(findings: Findings) -> Figure:
    """Draw both coordinates and the modulation over the camera's picture."""
    arrays = findings.arrays
    valid = arrays["valid"]
    ratio = panel_ratio([valid.shape])
    figure, (axes,) = new_figure(1, 3, (_WIDTH, _WIDTH / 3 * ratio + 0.4))
    modulation = np.where(np.isfinite(arrays["modulation"]), arrays["modulation"], np.nan)
    for axis, name, values in zip(
        axes,
        ("x, projector pixels", "y, projector pixels", "stripes over noise"),
        (arrays["x"], arrays["y"], modulation),
        strict=True,
    ):
        _map(axis, np.where(valid, values, np.nan), name)
    return figure


def rays_figure(findings: Findings) -> Figure:
    """Draw camera pixels, leak and noise of each ray."""
    maps = [findings.arrays[name] for name in ("pixels", "leak", "noise")]
    stacked = [image.reshape(-1, image.shape[-1]) for image in maps]
    ratio = panel_ratio([stacked[0].shape])
    figure, (axes,) = new_figure(1, 3, (_WIDTH, _WIDTH / 3 * ratio + 0.4))
    names = "camera pixels a ray", "leak, %", "noise over a pixel's"
    for axis, name, image, scale in zip(axes, names, stacked, (1, 100, 1), strict=True):
        _map(axis, scale * image, name)
    return figure


def symmetry_figure(findings: Findings) -> Figure:
    """Draw pairs both ways, and the error that their difference predicts."""
    facts, arrays = findings.facts, findings.arrays
    figure, ((left, right),) = new_figure(1, 2, (_WIDTH, 3.2))
    for index, scale in enumerate(facts["scales"]):
        side = scale["side_rays"]
        forward, backward, error = (
            arrays[f"{name}_{side}"] for name in ("forward", "backward", "error")
        )
        left.errorbar(
            forward,
            backward - forward,
            2 * error,
            fmt="o",
            markersize=3,
            linewidth=0.6,
            color=f"C{index}",
            label=f"patches of {side} ray{'s' if side > 1 else ''}",
        )
        right.errorbar(
            index, 100 * scale["predicted_error"], 200 * scale["standard_error"], fmt="o",
            color=f"C{index}",
        )  # fmt: skip
    left.axhline(0, color=_GREY, linewidth=0.8)
    left.legend(fontsize=7, frameon=False)
    label_below(left, "p2' T p1, relative")
    label_left(left, "p1' T p2 less p2' T p1, relative")
    right.axhline(100 * facts["tolerance"], color=_RED, linewidth=0.9)
    sides = [scale["side_rays"] for scale in facts["scales"]]
    right.set_xticks(range(len(sides)), [str(side) for side in sides])
    right.set_xlim(-0.5, len(sides) - 0.5)
    right.set_ylim(bottom=0)
    label_below(right, "patches, rays a side")
    label_left(right, "predicted error, %")
    return figure


def _map(axis: Axes, image: NDArray[Any], name: str) -> None:
    """Show a map of numbers with its scale; what is not a number in grey."""
    axis.set_facecolor("#cccccc")
    shown = axis.imshow(image, interpolation="nearest", cmap="viridis")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.set_title(name, fontsize=8)
    figure = axis.figure
    bar = figure.colorbar(shown, ax=axis, shrink=0.8)
    bar.ax.tick_params(labelsize=7)
