"""The page of a rig's calibration: each step's verdict, numbers and pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.scene import scene_image
from rfpipe.calibration.steps import STEPS
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import StoreError
from rfpipe.report.drawing import Map, draw, new_figure, plain_numbers, shared_legend
from rfpipe.report.page import Block, Illustration, Section, Table, table_of, write_page
from rfpipe.report.text import STANDING_COLOURS
from rfpipe.rigs.calibrated import STANDINGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BLUE, _RED, _GREY, _CYAN = "#1f5a9e", "#c4611a", "#9a9a9a", "#59e0e0"
_EXPOSURES = (_BLUE, _RED, "#2f7d36", "#7a4fa3", "#b58900", "#8c564b")
_FIT: dict[str, Any] = {"color": _RED, "linewidth": 0.9}
_DOTS: dict[str, Any] = {"marker": "o", "markersize": 3, "linestyle": ""}


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
    done = {name: folder.read(name) for name in STEPS if folder.is_done(name)}
    if not done:
        raise StoreError(f"{folder.path}: holds no calibration; run `rfpipe calibrate` first")
    read = {name: STANDINGS[findings.verdict.standing] for name, findings in done.items()}
    faults = [name for name, standing in read.items() if standing != STANDINGS["good"]]
    lead = "; ".join(f"{STEPS[name].title}: {read[name]}" for name in faults)
    rows = [[STEPS[name].title, standing] for name, standing in read.items()]
    caption = "In the order of the steps; each is explained below."
    table = Table("Verdicts", caption, ["step", "verdict"], rows, 2, is_folded=False)
    reasons = [f"{STEPS[name].title}: {done[name].verdict}" for name in faults]
    sections = [_section(name, done[name]) for name in done]
    sections.insert(0, Section("verdicts", "Verdicts", [table], reasons))
    page, lead = folder.path / "report.html", lead or "No step found a fault."
    write_page(page, "Calibration of the rig", lead, sections, STANDING_COLOURS)
    return page


def _section(name: str, findings: Findings) -> Section:
    title = STEPS[name].title
    verdict = f"Verdict: {findings.verdict}"
    if findings.verdict.standing == "failed":
        return Section(name, title, [], [verdict])
    numbers = [
        {"number": fact, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
        for fact, value in findings.facts.items()
        if isinstance(value, bool | int | float | str)
    ]
    labels = [("number", "number", str), ("value", "value", str)]
    about = "Units stand in the names."
    table = table_of("Numbers", about, numbers, labels, [], csv=f"{name}.csv")
    blocks: list[Block] = [table]
    if name in _CHARTS:
        chart, caption = _CHARTS[name]
        blocks.insert(0, Illustration(title, caption, name, chart(findings)))
    return Section(name, title, blocks, [verdict])


def _plot(below: str, left: str) -> tuple[Figure, Axes]:
    """Return a figure of one plot, with its labels."""
    figure, ((axis,),) = new_figure(1, 1, (5.0, 3.1))
    axis.set(xlabel=below, ylabel=left)
    return figure, axis


def _maps(**images: NDArray[Any]) -> Figure:
    """Show maps side by side, each with its scale."""
    maps = [Map(image, scale=name.replace("_", " ")) for name, image in images.items()]
    return draw([maps], 2.6)


def _errors(axis: Axes, x: Any, y: Any, error: Any, **style: Any) -> None:
    """Draw measurements with bars of two standard errors."""
    axis.errorbar(x, y, 2 * error, **{"color": _BLUE, "linewidth": 0.8, **_DOTS, **style})


def _latency(one: Findings) -> Figure:
    figure, axis = _plot("wait after a picture was drawn, ms", "share of the step seen")
    axis.plot(1000 * one["waits"], one["worst"], color=_BLUE, **_DOTS)
    axis.axvline(1000 * one["settle_seconds"], color=_GREY, linestyle="--")
    axis.set_ylim(-0.1, 1.1)
    return figure


def _steadiness(one: Findings) -> Figure:
    """Draw the light of lit looks, by the exposures that the verdict is about."""
    figure, axis = _plot("lit look", "light over that of the references, less 1, %")
    axis.axhline(0, color=_GREY, linewidth=0.8)
    gains, exposures = one["gain"], one.facts.get("exposures_s")
    judged = one.arrays.get("judged", np.ones(gains.shape[1], bool))
    looks = np.arange(1, 1 + len(gains))
    for index in np.flatnonzero(judged):
        name = f"exposure {index + 1}" if exposures is None else f"{exposures[index]:.3g} s"
        look = {"color": _EXPOSURES[index % len(_EXPOSURES)], "label": name, **_DOTS}
        axis.plot(looks, 100 * (gains[:, index] - 1), **look)
    if judged.any():
        shared_legend(figure)
    return figure


def _scene(one: Findings) -> Figure:
    picture = scene_image(*(one[name] for name in ("white", "saturated", "dark", "lit")))
    sight = Map(picture, "white, less black")
    dark = Map(one["black"], "all off", scale="counts")
    focus = Map(one["focus"], "contrast of stripes", scale="contrast")
    return draw([[sight, dark, focus]], 2.6)


def _dark(one: Findings) -> Figure:
    figure, axis = _plot("exposure, s", "mean without light, counts")
    times = np.array(one["exposures_s"])
    axis.plot(times, one["level_counts"], "o", color=_BLUE)
    axis.plot(times, one["black_level_counts"] + one["current_counts_per_s"] * times, **_FIT)
    axis.ticklabel_format(axis="y", useOffset=False)
    return figure


def _linearity(one: Findings) -> Figure:
    figure, axis = _plot("counts above black, fraction of full scale", "deviation, %")
    axis.axhline(0, color=_GREY, linewidth=0.8)
    _errors(axis, one["level"], 100 * one["deviation"], 100 * one["error"])
    axis.set_xscale("log")
    plain_numbers(axis.xaxis, (1, 3))
    return figure


def _light(one: Findings) -> Figure:
    figure, axis = _plot("code", "light, fraction of code 255")
    axis.plot(np.arange(256), one["light"], **_FIT)
    _errors(axis, one["codes"], one["measured"], one["error"])
    return figure


def _transfer(one: Findings) -> Figure:
    signal, variance, model, used = (one[name] for name in ("signal", "variance", "model", "used"))
    figure, axis = _plot("signal, counts", "variance, counts²")
    other = ~used & (signal > 0) & (variance > 0)
    axis.loglog(signal[other], variance[other], color=_GREY, fillstyle="none", **_DOTS)
    axis.loglog(signal[used], model[used], **_FIT)
    _errors(axis, signal[used], variance[used], one["error"][used])
    return figure


def _correspondence(one: Findings) -> Figure:
    x, y, above = (np.where(one["valid"], one[name], np.nan) for name in ("x", "y", "modulation"))
    return _maps(x__projector_pixels=x, y__projector_pixels=y, stripes_over_noise=above)


def _rays(one: Findings) -> Figure:
    coverage = np.diff(one["resampling_starts"]).reshape(one["pixels"].shape) > 0
    pixels, leak, noise = (
        np.where(coverage, one[name], np.nan).reshape(-1, coverage.shape[-1])
        for name in ("pixels", "leak", "noise")
    )
    return _maps(camera_pixels_a_ray=pixels, leak__share=leak, noise_over_a_pixel_s=noise)


_CHARTS: dict[str, tuple[Callable[[Findings], Figure], str]] = {
    "latency": (_latency, "Least share of a picture's step that the first exposure saw."),
    "steadiness": (
        _steadiness,
        (
            "Light of the looks at a pattern and at its complement, by exposures; looks at black "
            "are not shown. The verdict is about the mean of these exposures; others, mostly "
            "saturated or dark, are too noisy and are left out."
        ),
    ),
    "scene": (_scene, "Red: saturated; blue: within the noise; yellow: the projector's outline."),
    "dark": (_dark, "Counts without light, whose slope is dark current and leaking light."),
    "linearity": (
        _linearity,
        "Light by the shorter of two exposures over the longer's, less 1.",
    ),
    "light": (_light, "Light of each code over the lit camera pixels, and the curve through it."),
    "transfer": (_transfer, "Variance between two pictures of the same light, and its model."),
    "correspondence": (_correspondence, "Where on the projector each camera pixel looks."),
    "rays": (_rays, "Camera pixels a ray, light that leaks into each, and its noise, by views."),
}
