"""Page of a rig's calibration: verdict, numbers and charts of each step."""

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
    """Write the page of the finished steps.

    Parameters
    ----------
    folder : CalibrationFolder

    Returns
    -------
    Path
        ``report.html`` in the folder, with embedded pictures; they are also in ``figures/``, and
        tables in ``tables/``.

    Raises
    ------
    StoreError
        If no step is finished.
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
    caption = "Units are part of the names."
    table = table_of("Numbers", caption, numbers, labels, [], csv=f"{name}.csv")
    blocks: list[Block] = [table]
    if name in _CHARTS:
        chart, chart_caption = _CHARTS[name]
        blocks.insert(0, Illustration(title, chart_caption, name, chart(findings)))
    return Section(name, title, blocks, [verdict])


def _plot(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    """Return a figure of one plot, with its labels."""
    figure, ((axis,),) = new_figure(1, 1, (5.0, 3.1))
    axis.set(xlabel=x_label, ylabel=y_label)
    return figure, axis


def _maps(**images: NDArray[Any]) -> Figure:
    """Draw maps side by side, each with its scale."""
    maps = [Map(image, scale=name.replace("_", " ")) for name, image in images.items()]
    return draw([maps], 2.6)


def _errors(axis: Axes, x: Any, y: Any, error: Any, **style: Any) -> None:
    """Draw measurements with bars of two standard errors."""
    axis.errorbar(x, y, 2 * error, **{"color": _BLUE, "linewidth": 0.8, **_DOTS, **style})


def _latency(findings: Findings) -> Figure:
    figure, axis = _plot("wait after a picture was drawn, ms", "visible share of the step")
    axis.plot(1000 * findings["waits"], findings["worst"], color=_BLUE, **_DOTS)
    axis.axvline(1000 * findings["settle_seconds"], color=_GREY, linestyle="--")
    axis.set_ylim(-0.1, 1.1)
    return figure


def _steadiness(findings: Findings) -> Figure:
    """Draw the light of lit check pictures, for the exposures that the verdict is about."""
    figure, axis = _plot("lit check picture", "light over that of the references, less 1, %")
    axis.axhline(0, color=_GREY, linewidth=0.8)
    gains, exposures = findings["gain"], findings.facts.get("exposures_s")
    judged = findings.arrays.get("judged", np.ones(gains.shape[1], bool))
    numbers = np.arange(1, 1 + len(gains))
    for index in np.flatnonzero(judged):
        name = f"exposure {index + 1}" if exposures is None else f"{exposures[index]:.3g} s"
        style = {"color": _EXPOSURES[index % len(_EXPOSURES)], "label": name, **_DOTS}
        axis.plot(numbers, 100 * (gains[:, index] - 1), **style)
    if judged.any():
        shared_legend(figure)
    return figure


def _scene(findings: Findings) -> Figure:
    picture = scene_image(*(findings[name] for name in ("white", "saturated", "dark", "lit")))
    sight = Map(picture, "white, less black")
    dark = Map(findings["black"], "all off", scale="counts")
    focus = Map(findings["focus"], "contrast of stripes", scale="contrast")
    return draw([[sight, dark, focus]], 2.6)


def _dark(findings: Findings) -> Figure:
    figure, axis = _plot("exposure, s", "mean without light, counts")
    times = np.array(findings["exposures_s"])
    axis.plot(times, findings["level_counts"], "o", color=_BLUE)
    axis.plot(
        times, findings["black_level_counts"] + findings["current_counts_per_s"] * times, **_FIT
    )
    axis.ticklabel_format(axis="y", useOffset=False)
    return figure


def _linearity(findings: Findings) -> Figure:
    figure, axis = _plot("counts above black, fraction of full scale", "deviation, %")
    axis.axhline(0, color=_GREY, linewidth=0.8)
    _errors(axis, findings["level"], 100 * findings["deviation"], 100 * findings["error"])
    axis.set_xscale("log")
    plain_numbers(axis.xaxis, (1, 3))
    return figure


def _light(findings: Findings) -> Figure:
    figure, axis = _plot("code", "light, fraction of code 255")
    axis.plot(np.arange(256), findings["light"], **_FIT)
    _errors(axis, findings["codes"], findings["measured"], findings["error"])
    return figure


def _transfer(findings: Findings) -> Figure:
    signal, variance, model, used = (
        findings[name] for name in ("signal", "variance", "model", "used")
    )
    figure, axis = _plot("signal, counts", "variance, counts²")
    unused = ~used & (signal > 0) & (variance > 0)
    axis.loglog(signal[unused], variance[unused], color=_GREY, fillstyle="none", **_DOTS)
    axis.loglog(signal[used], model[used], **_FIT)
    _errors(axis, signal[used], variance[used], findings["error"][used])
    return figure


def _correspondence(findings: Findings) -> Figure:
    x, y, above = (
        np.where(findings["valid"], findings[name], np.nan) for name in ("x", "y", "modulation")
    )
    return _maps(x__projector_pixels=x, y__projector_pixels=y, stripes_over_noise=above)


def _rays(findings: Findings) -> Figure:
    coverage = np.diff(findings["resampling_starts"]).reshape(findings["pixels"].shape) > 0
    pixels, leak, noise = (
        np.where(coverage, findings[name], np.nan).reshape(-1, coverage.shape[-1])
        for name in ("pixels", "leak", "noise")
    )
    return _maps(camera_pixels_per_ray=pixels, leak__share=leak, noise_over_a_pixel_s=noise)


_CHARTS: dict[str, tuple[Callable[[Findings], Figure], str]] = {
    "latency": (
        _latency,
        "Smallest share of a picture's step that was visible in the first exposure.",
    ),
    "steadiness": (
        _steadiness,
        (
            "Light of the check pictures of a pattern and of its complement, by exposures; black "
            "check pictures are not shown. The verdict is about the mean of these exposures; "
            "further ones, mostly saturated or dark, are too noisy and are omitted."
        ),
    ),
    "scene": (_scene, "Red: saturated; blue: within the noise; yellow: the projector's outline."),
    "dark": (_dark, "Counts without light; their slope is dark current and stray light."),
    "linearity": (
        _linearity,
        "Light by the shorter of two exposures over that by the longer one, less 1.",
    ),
    "light": (_light, "Light of each code over the lit camera pixels, and the curve through it."),
    "transfer": (_transfer, "Variance between two pictures of the same light, and its model."),
    "correspondence": (_correspondence, "Projector coordinates of each camera pixel."),
    "rays": (
        _rays,
        "Camera pixels of each ray, light that leaks into it, and its noise, view by view.",
    ),
}
