"""The page of a rig's calibration: what each step found, with pictures and a verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration import STEPS, CalibrationFolder
from rfpipe.calibration.base import Findings
from rfpipe.errors import StoreError
from rfpipe.photometry import Resampling
from rfpipe.report.blocks import Block, Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import label_below, label_left, new_figure, panel_ratio, show_image
from rfpipe.report.page import write_page
from rfpipe.report.sight import SCENE_CAPTION, scene_figure
from rfpipe.report.verdicts import STANDING_COLOURS
from rfpipe.rigs.calibrated import STANDINGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["build_calibration_report"]


def build_calibration_report(folder: CalibrationFolder) -> Path:
    """Write the page of the steps that are done.

    Parameters
    ----------
    folder : CalibrationFolder

    Returns
    -------
    Path
        ``report.html`` in the folder; pictures embedded, and beside it in ``figures/``; tables in
        ``tables/``.

    Raises
    ------
    StoreError
        When no step is done.
    """
    found = {name: folder.read(name) for name in STEPS if folder.is_done(name)}
    if not found:
        raise StoreError(f"{folder.path}: holds no calibration; run `rfpipe calibrate` first")
    titles = {
        standing: ", ".join(
            STEPS[name].title.lower()
            for name, findings in found.items()
            if findings.verdict.standing == standing
        )
        for standing in STANDINGS
    }
    words = {"poor": "Not good enough yet", "failed": "Not measured", "unknown": "Can't tell"}
    lead = " ".join(f"{word}: {titles[of]}." for of, word in words.items() if titles[of])
    page = folder.path / "report.html"
    rest = [_section(name, one) for name, one in found.items() if name != "scene"]
    sections = [_first(found), *rest]
    write_page(
        page, "Calibration of the rig", lead or "No step found a fault.", sections,
        STANDING_COLOURS,
    )  # fmt: skip
    return page


def _first(found: dict[str, Findings]) -> Section:
    """Return the page's beginning: all verdicts, and what the camera sees."""
    rows = [
        [STEPS[name].title, STANDINGS[findings.verdict.standing]]
        for name, findings in found.items()
    ]
    table = Table([], ["step", "verdict"], rows, text_columns=2)
    caption = "What each step found. What isn't good is told above, with what to do."
    blocks: list[Block] = [Tabulation("Verdicts", caption, table, is_folded=False)]
    reasons = [
        f"{STEPS[name].title}: {STANDINGS[findings.verdict.standing]}. {findings.verdict.text}"
        for name, findings in found.items()
        if findings.verdict.standing != "good" or name == "scene"
    ]
    if "scene" in found:
        blocks += _section("scene", found["scene"], found).blocks
    return Section("scene", "What the camera sees", blocks, reasons)


def _section(name: str, findings: Findings, others: dict[str, Findings] | None = None) -> Section:
    title = STEPS[name].title
    verdict = f"Verdict: {STANDINGS[findings.verdict.standing]}. {findings.verdict.text}"
    if findings.verdict.standing == "failed":
        return Section(name, title, [], [verdict])
    draw, caption = _CHARTS[name]
    labels = [("number", "number", str), ("value", "value", str)]
    table = table_of(_numbers(findings.facts), labels, [], csv=f"{name}.csv")
    drawn = scene_figure(others) if others is not None else draw(findings)
    return Section(
        name,
        title,
        [
            Illustration(title, caption, name, drawn),
            Tabulation("Numbers", "Units stand in the names.", table),
        ],
        [verdict],
    )


def _numbers(facts: dict[str, Any]) -> list[dict[str, str]]:
    """Return the facts that are single numbers or texts."""
    return [
        {"number": name, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
        for name, value in facts.items()
        if isinstance(value, bool | int | float | str)
    ]


_Draw: TypeAlias = "Callable[[Findings], Figure]"

_CHARTS: dict[str, tuple[_Draw, str]] = {
    "scene": (lambda findings: scene_figure({"scene": findings}), SCENE_CAPTION)
}
"""What draws a step's findings, and its caption."""


def _chart_of(step: str, caption: str) -> Callable[[_Draw], _Draw]:
    """Register what draws a step's findings."""

    def register(draw: _Draw) -> _Draw:
        _CHARTS[step] = draw, caption
        return draw

    return register


_UNSEEN = (0.85, 0.1, 0.1)
_BLUE, _RED, _GREY = "#1f5a9e", "#c4611a", "#9a9a9a"
_WIDTH = 8.4
_FIT: dict[str, Any] = {"color": _RED, "linewidth": 0.9}
_DOTS: dict[str, Any] = {"marker": "o", "markersize": 3, "linestyle": ""}


def _plots(
    *labels: tuple[str, str], size: tuple[float, float] = (_WIDTH, 3.0)
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure of plots side by side, each with what stands below it and on its left."""
    figure, (axes,) = new_figure(1, len(labels), size)
    for axis, (below, left) in zip(axes, labels, strict=True):
        label_below(axis, below)
        label_left(axis, left)
    return figure, axes


def _measured(
    axis: Axes, x: NDArray[Any], y: NDArray[Any], error: NDArray[Any], *, scale: float = 1
) -> None:
    """Draw measurements with bars of two standard errors, y times a scale."""
    axis.errorbar(x, scale * y, 2 * scale * error, color=_BLUE, **{**_DOTS, "linewidth": 0.8})


@_chart_of(
    "latency",
    "Share of the step from one picture to the next that the camera's first exposure saw in the "
    "worst of some trials, after each wait: 1 where the new picture was all that it saw. Dashed: "
    "what the settings wait.",
)
def _latency(findings: Findings) -> Figure:
    """Draw what was seen after each wait, and what the settings wait."""
    labels = "wait after a picture was drawn, ms", "share of the step seen"
    figure, (axis,) = _plots(labels, size=(_WIDTH * 0.6, 3.0))
    waits, settle = 1000 * findings.arrays["waits"], findings.facts["settle_seconds"]
    settled = 0.0 if settle is None else 1000 * settle
    axis.plot(waits, findings.arrays["worst"], color=_BLUE, **_DOTS)
    if settle is not None:
        axis.axvline(settled, color=_GREY, linestyle="--")
    axis.set_xlim(-2, 1.1 * max(40.0, settled, float(waits.max())))
    axis.set_ylim(-0.1, 1.1)
    return figure


@_chart_of(
    "dark",
    "Left: counts without light against the exposure time; the slope is the dark "
    "current and what light is left. Right: the black level of each photosite at "
    "the longest exposure.",
)
def _dark(findings: Findings) -> Figure:
    """Draw the black level against exposure, and as a picture."""
    facts, black = findings.facts, findings.arrays["black"]
    figure, (left, right) = _plots(("exposure, s", "mean without light, counts"), ("", ""))
    times = np.array(facts["exposures_s"])
    line = facts["black_level_counts"] + facts["current_counts_per_s"] * times
    left.plot(times, facts["level_counts"], "o", color=_BLUE)
    left.plot(times, line, **_FIT)
    left.ticklabel_format(axis="y", useOffset=False)
    longest = black[-1]
    _map(right, longest if longest.ndim == 2 else longest.mean(axis=-1), "counts")
    return figure


@_chart_of(
    "linearity",
    "Light by the shorter of two exposures over that by the longer one, less 1, "
    "against the longer one's counts as a fraction of full scale; bars are two "
    "standard errors.",
)
def _linearity(findings: Findings) -> Figure:
    """Draw the deviation between exposures against the level."""
    labels = "counts above black, fraction of full scale", "deviation, %"
    figure, (axis,) = _plots(labels, size=(_WIDTH * 0.6, 3.0))
    axis.axhline(0, color=_GREY, linewidth=0.8)
    level, deviation, error = (
        findings.arrays[f"linearity_{name}"] for name in ("level", "deviation", "error")
    )
    _measured(axis, level, deviation, error, scale=100)
    axis.set_xscale("log")
    return figure


@_chart_of(
    "light",
    "Light of each code as a fraction of that of 255: median over the lit camera "
    "pixels, and the monotone curve through them. Right: what the curve adds to a "
    "gamma of 2.2.",
)
def _light(findings: Findings) -> Figure:
    """Draw the projector's response."""
    arrays = findings.arrays
    codes, measured = arrays["codes"], arrays["measured"]
    response, every = arrays["light"], np.arange(256)
    figure, (left, right) = _plots(
        ("code", "light, fraction of code 255"), ("code", "less gamma 2.2, %")
    )
    left.plot(every, response, **_FIT)
    left.plot(codes, measured, color=_BLUE, **_DOTS)
    right.plot(every, 100 * (response - (every / 255) ** 2.2), **_FIT)
    _measured(right, codes, measured - (codes / 255) ** 2.2, arrays["error"], scale=100)
    return figure


@_chart_of(
    "transfer",
    "Variance between two pictures of the same light against their mean signal, in "
    "counts: measured (filled: used) and the fit of read noise, photon noise and "
    "rounding. Right: measured over fitted; bars are two standard errors.",
)
def _transfer(findings: Findings) -> Figure:
    """Draw the photon-transfer curve."""
    signal, variance, error, model, used = (
        findings.arrays[f"ptc_{name}"] for name in ("signal", "variance", "error", "model", "used")
    )
    other = ~used & (signal > 0) & (variance > 0)
    figure, (left, right) = _plots(
        ("signal, counts", "variance, counts²"), ("signal, counts", "measured over fitted"),
        size=(_WIDTH, 3.2),
    )  # fmt: skip
    left.loglog(signal[other], variance[other], color=_GREY, fillstyle="none", **_DOTS)
    left.loglog(signal[used], variance[used], color=_BLUE, **_DOTS)
    left.loglog(signal[used], model[used], **_FIT)
    right.axhline(1, **_FIT)
    _measured(right, signal[used], variance[used] / model[used], error[used] / model[used])
    right.set_xscale("log")
    return figure


@_chart_of(
    "correspondence",
    "Where on the projector each camera pixel looks (x and y in projector pixels), "
    "and how far the stripes rise above their noise. Grey: not valid.",
)
def _correspondence(findings: Findings) -> Figure:
    """Draw both coordinates and the modulation over the camera's picture."""
    arrays = findings.arrays
    maps = {
        "x, projector pixels": arrays["x"],
        "y, projector pixels": arrays["y"],
        "stripes over noise": arrays["modulation"],
    }
    valid = arrays["valid"]
    return _maps({name: np.where(valid, values, np.nan) for name, values in maps.items()})


@_chart_of(
    "rays",
    "The projector's rays: those that the camera doesn't see in red, the others the brighter the "
    "more camera pixels look at them; camera pixels a ray; light of other rays that leaks into "
    "each, per unit of theirs; and the noise of a ray over that of a camera pixel. Views one above "
    "the other.",
)
def _rays(findings: Findings) -> Figure:
    """Draw which rays are seen, and camera pixels, leak and noise of each."""
    arrays = findings.arrays
    seen = Resampling.from_arrays(arrays).seen
    maps = {
        "camera pixels a ray": np.where(seen, arrays["pixels"], np.nan),
        "leak, %": np.where(seen, 100 * arrays["leak"], np.nan),
        "noise over a pixel's": np.where(seen, arrays["noise"], np.nan),
    }
    maps = {name: image.reshape(-1, image.shape[-1]) for name, image in maps.items()}
    grey = arrays["pixels"] / max(float(arrays["pixels"].max()), 1e-9)
    picture = np.where(seen[..., None], 0.25 + 0.7 * grey[..., None], _UNSEEN)
    picture = picture.reshape(-1, picture.shape[-2], 3)
    ratio = panel_ratio([picture.shape])
    figure, axes = _plots(*[("", "")] * 4, size=(_WIDTH, _WIDTH / 4 * ratio + 0.4))
    show_image(axes[0], picture)
    axes[0].set_title(f"unseen rays: {np.count_nonzero(~seen):,} of {seen.size:,}", fontsize=8)
    for axis, (name, image) in zip(axes[1:], maps.items(), strict=True):
        _map(axis, image, name)
    return figure


@_chart_of(
    "symmetry",
    "Left: pairs of random patterns, lit one way and the other; bars are two "
    "standard errors of the noise. Right: the error that asymmetry predicts for "
    "relit pictures, with two standard errors, and what is accepted.",
)
def _symmetry(findings: Findings) -> Figure:
    """Draw pairs both ways, and the error that their difference predicts."""
    facts, arrays = findings.facts, findings.arrays
    figure, (left, right) = _plots(
        ("p2' T p1, relative", "p1' T p2 less p2' T p1, relative"),
        ("patches, rays a side", "predicted error, %"),
        size=(_WIDTH, 3.2),
    )
    for index, scale in enumerate(facts["scales"]):
        side = scale["side_rays"]
        forward, backward, error = (
            arrays[f"{name}_{side}"] for name in ("forward", "backward", "error")
        )
        left.errorbar(
            forward, backward - forward, 2 * error, fmt="o", markersize=3, linewidth=0.6,
            color=f"C{index}", label=f"patches of {side} ray{'s' if side > 1 else ''}",
        )  # fmt: skip
        right.errorbar(
            index, 100 * scale["predicted_error"], 200 * scale["standard_error"], fmt="o",
            color=f"C{index}",
        )  # fmt: skip
    left.axhline(0, color=_GREY, linewidth=0.8)
    left.legend(fontsize=7, frameon=False)
    right.axhline(100 * facts["tolerance"], **_FIT)
    sides = [scale["side_rays"] for scale in facts["scales"]]
    right.set_xticks(range(len(sides)), [str(side) for side in sides])
    right.set_xlim(-0.5, len(sides) - 0.5)
    right.set_ylim(bottom=0)
    return figure


def _maps(images: dict[str, NDArray[Any]]) -> Figure:
    """Draw three maps of one shape side by side."""
    ratio = panel_ratio([image.shape for image in images.values()])
    figure, axes = _plots(*[("", "")] * 3, size=(_WIDTH, _WIDTH / 3 * ratio + 0.4))
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        _map(axis, image, name)
    return figure


def _map(axis: Axes, image: NDArray[Any], name: str) -> None:
    """Show a map of numbers with its scale; what is not a number in grey."""
    axis.set_facecolor("#cccccc")
    shown = show_image(axis, image, cmap="viridis")
    axis.set_title(name, fontsize=8)
    bar = axis.figure.colorbar(shown, ax=axis, shrink=0.8)
    bar.ax.tick_params(labelsize=7)
