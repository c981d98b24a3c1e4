"""The page of a rig's calibration: each step's verdict, numbers and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.sight import YELLOW, sight_picture
from rfpipe.calibration.steps import STEPS
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import StoreError
from rfpipe.report.blocks import Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import label_below, label_left, new_figure, panel_ratio, show_image
from rfpipe.report.page import write_page
from rfpipe.report.verdicts import STANDING_COLOURS
from rfpipe.rigs.calibrated import STANDINGS
from rfpipe.rigs.layout import ProjectorLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

All = Mapping[str, Findings]

_BLUE, _RED, _GREY, _CYAN = "#1f5a9e", "#c4611a", "#9a9a9a", "#59e0e0"
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
    found = {name: folder.read(name) for name in STEPS if folder.is_done(name)}
    if not found:
        raise StoreError(f"{folder.path}: holds no calibration; run `rfpipe calibrate` first")
    standings = {name: findings.verdict.standing for name, findings in found.items()}
    lead = []
    for of, words in {
        "poor": "Not good enough yet", "failed": "Not measured", "unknown": "Can't tell"
    }.items():  # fmt: skip
        titles = [STEPS[name].title.lower() for name, one in standings.items() if one == of]
        lead += [f"{words}: {', '.join(titles)}."] if titles else []
    rows = [[STEPS[name].title, STANDINGS[one]] for name, one in standings.items()]
    table = Table([], ["step", "verdict"], rows, text_columns=2)
    verdicts = Tabulation("Verdicts", "", table, is_folded=False)
    reasons = [
        f"{STEPS[name].title}: {_verdict(findings)}"
        for name, findings in found.items()
        if standings[name] != "good"
    ]
    sections = [_section(name, found) for name in sorted(found, key="scene".__ne__)]
    sections.insert(0, Section("verdicts", "Verdicts", [verdicts], reasons))
    page = folder.path / "report.html"
    text = " ".join(lead) or "No step found a fault."
    title = "Calibration of the rig"
    write_page(page, title, text, sections, STANDING_COLOURS)
    return page


def _verdict(findings: Findings) -> str:
    return f"{STANDINGS[findings.verdict.standing]}. {findings.verdict.text}"


def _section(name: str, found: All) -> Section:
    title, findings = STEPS[name].title, found[name]
    verdict = f"Verdict: {_verdict(findings)}"
    if findings.verdict.standing == "failed":
        return Section(name, title, [], [verdict])
    numbers = [
        {"number": fact, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
        for fact, value in findings.facts.items()
        if isinstance(value, bool | int | float | str)
    ]
    labels = [("number", "number", str), ("value", "value", str)]
    table = table_of(numbers, labels, [], csv=f"{name}.csv")
    draw, caption = _CHARTS[name]
    chart = Illustration(title, caption, name, draw(found))
    numbers_below = Tabulation("Numbers", "Units stand in the names.", table)
    return Section(name, title, [chart, numbers_below], [verdict])


def _plots(*labels: tuple[str, str]) -> tuple[Figure, NDArray[Any]]:
    """Make a figure of plots side by side, each with its labels below and on the left."""
    figure, (axes,) = new_figure(1, len(labels), (8.4 if len(labels) > 1 else 5.0, 3.1))
    for axis, (below, left) in zip(axes, labels, strict=True):
        label_below(axis, below)
        label_left(axis, left)
    return figure, axes


def _maps(**images: NDArray[Any] | None) -> tuple[Figure, NDArray[Any]]:
    """Show maps side by side, each with its scale; None leaves a panel empty."""
    shape = next(image.shape for image in images.values() if image is not None)
    size = 8.4, 8.4 / len(images) * panel_ratio([shape]) + 0.4
    figure, (axes,) = new_figure(1, len(images), size)
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        axis.set_title(name.replace("_", " "), fontsize=8)
        axis.set_facecolor("#cccccc")
        if image is not None:
            shown = show_image(axis, image, cmap="viridis")
            figure.colorbar(shown, ax=axis, shrink=0.8).ax.tick_params(labelsize=7)
    return figure, axes


def _errors(axis: Axes, x: Any, y: Any, error: Any, **style: Any) -> None:
    """Draw measurements with bars of two standard errors."""
    axis.errorbar(x, y, 2 * error, **{"color": _BLUE, "linewidth": 0.8, **_DOTS, **style})


def _latency(found: All) -> Figure:
    one = found["latency"]
    figure, (axis,) = _plots(("wait after a picture was drawn, ms", "share of the step seen"))
    axis.plot(1000 * one["waits"], one["worst"], color=_BLUE, **_DOTS)
    if one["settle_seconds"] is not None:
        axis.axvline(1000 * one["settle_seconds"], color=_GREY, linestyle="--")
    axis.set_ylim(-0.1, 1.1)
    return figure


def _scene(found: All) -> Figure:
    scene = found["scene"]
    lit, white = scene["lit"], scene["white"]
    figure, (left, *_) = _maps(
        white_less_black__outline__rays=None,
        all_off__counts=scene["black"],
        contrast_of_stripes=scene["focus"],
    )
    show_image(left, sight_picture(white, scene["saturated"], scene["dark"]))
    if lit.any() and not lit.all():
        outline = np.pad(lit, 1).astype(float)
        y, x = (np.arange(extent) - 1.0 for extent in outline.shape)
        left.contour(x, y, outline, levels=[0.5], colors=[YELLOW], linewidths=1.2)
    if "rays" in found and "ray_of_pixel" in found["rays"].arrays:
        seen, layout = found["correspondence"], ProjectorLayout.from_arrays(found["rays"].arrays)
        width = layout.shape[-1]
        for axis, (name, extent) in enumerate((("x", width), ("y", layout.shape[-2]))):
            # some of the rays' borders, by where the camera's pixels look
            index = layout.ray_of_pixel % width if axis == 0 else layout.ray_of_pixel // width
            index = np.where(layout.ray_of_pixel >= 0, index, -1).max(axis=axis)
            borders = np.flatnonzero(np.diff(index) != 0) + 1.0
            levels = np.unique(np.append(borders[:: max(1, extent // 8)], borders[-1:]))
            where = np.where(seen["valid"], seen[name], np.nan)
            left.contour(where, levels=levels, colors=_CYAN, linewidths=0.5)
    left.set(xlim=(-0.5, white.shape[1] - 0.5), ylim=(white.shape[0] - 0.5, -0.5))
    return figure


def _dark(found: All) -> Figure:
    one = found["dark"]
    figure, (left, right) = _plots(("exposure, s", "mean without light, counts"), ("", ""))
    times = np.array(one["exposures_s"])
    left.plot(times, one["level_counts"], "o", color=_BLUE)
    left.plot(times, one["black_level_counts"] + one["current_counts_per_s"] * times, **_FIT)
    left.ticklabel_format(axis="y", useOffset=False)
    longest = one["black"][-1]
    image = longest if longest.ndim == 2 else longest.mean(axis=-1)
    bar = figure.colorbar(show_image(right, image, cmap="viridis"), ax=right, shrink=0.8)
    bar.set_label("counts", fontsize=8)
    return figure


def _linearity(found: All) -> Figure:
    one = found["linearity"]
    figure, (axis,) = _plots(("counts above black, fraction of full scale", "deviation, %"))
    axis.axhline(0, color=_GREY, linewidth=0.8)
    _errors(axis, one["level"], 100 * one["deviation"], 100 * one["error"])
    axis.set_xscale("log")
    return figure


def _light(found: All) -> Figure:
    one, every = found["light"], np.arange(256)
    codes, measured = one["codes"], one["measured"]
    figure, (left, right) = _plots(
        ("code", "light, fraction of code 255"), ("code", "less gamma 2.2, %")
    )
    left.plot(every, one["light"], **_FIT)
    left.plot(codes, measured, color=_BLUE, **_DOTS)
    right.plot(every, 100 * (one["light"] - (every / 255) ** 2.2), **_FIT)
    _errors(right, codes, 100 * (measured - (codes / 255) ** 2.2), 100 * one["error"])
    return figure


def _transfer(found: All) -> Figure:
    one = found["transfer"]
    signal, variance, model, used = (one[name] for name in ("signal", "variance", "model", "used"))
    figure, (left, right) = _plots(
        ("signal, counts", "variance, counts²"), ("signal, counts", "measured over fitted")
    )
    other = ~used & (signal > 0) & (variance > 0)
    left.loglog(signal[other], variance[other], color=_GREY, fillstyle="none", **_DOTS)
    left.loglog(signal[used], variance[used], color=_BLUE, **_DOTS)
    left.loglog(signal[used], model[used], **_FIT)
    right.axhline(1, **_FIT)
    _errors(right, signal[used], (variance / model)[used], (one["error"] / model)[used])
    right.set_xscale("log")
    return figure


def _correspondence(found: All) -> Figure:
    one = found["correspondence"]
    x, y, above = (np.where(one["valid"], one[name], np.nan) for name in ("x", "y", "modulation"))
    return _maps(x__projector_pixels=x, y__projector_pixels=y, stripes_over_noise=above)[0]


def _rays(found: All) -> Figure:
    one = found["rays"]
    seen = np.diff(one["resampling_starts"]).reshape(one["pixels"].shape) > 0
    pixels, leak, noise = (
        np.where(seen, one[name], np.nan).reshape(-1, seen.shape[-1])
        for name in ("pixels", "leak", "noise")
    )
    return _maps(
        camera_pixels_a_ray=pixels, leak__share=leak, noise_over_a_pixel_s=noise
    )[0]  # fmt: skip


def _symmetry(found: All) -> Figure:
    one = found["symmetry"]
    figure, (left, right) = _plots(
        ("p2' T p1, relative", "p1' T p2 less p2' T p1, relative"),
        ("patches, rays a side", "predicted error, %"),
    )
    sides = [scale["side_rays"] for scale in one["scales"]]
    for index, (side, scale) in enumerate(zip(sides, one["scales"], strict=True)):
        ahead, back, error = (one[f"{name}_{side}"] for name in ("forward", "backward", "error"))
        style = {"color": f"C{index}", "label": f"patches of {side} x {side} rays"}
        _errors(left, ahead, back - ahead, error, **style)
        _errors(
            right, index, 100 * scale["predicted_error"], 100 * scale["standard_error"], **style
        )
    left.axhline(0, color=_GREY, linewidth=0.8)
    left.legend(fontsize=7, frameon=False)
    right.axhline(100 * one["tolerance"], **_FIT)
    right.set_xticks(range(len(sides)), [str(side) for side in sides])
    right.set(xlim=(-0.5, len(sides) - 0.5))
    right.set_ylim(bottom=0)
    return figure


class _Chart(NamedTuple):
    draw: Callable[[All], Figure]
    caption: str


_CHARTS: dict[str, _Chart] = {
    "latency": _Chart(_latency, "The least share of the step from one picture to the next that "
        "the camera's first exposure saw after each wait. Dashed: what the settings wait."),
    "scene": _Chart(_scene, "Left: the projector's white, black taken off; red: saturated at all "
        "exposures; blue: within the noise at all; yellow: the projector's outline; thin lines: "
        "some rays' borders. Middle: all off, at the longest exposure. Right: the contrast that "
        "fine stripes keep; grey: not lit."),
    "dark": _Chart(_dark, "Left: counts without light; the slope is dark current and what light "
        "is left. Right: the black level of each photosite at the longest exposure."),
    "linearity": _Chart(_linearity, "Light by the shorter of two exposures over that by the "
        "longer one, less 1; bars are two standard errors."),
    "light": _Chart(_light, "Light of each code: median over the lit camera pixels, and the "
        "monotone curve through them. Right: what the curve adds to a gamma of 2.2."),
    "transfer": _Chart(_transfer, "Variance between two pictures of the same light (filled: "
        "used), and the fit of read noise, photon noise and rounding; bars are two standard "
        "errors."),
    "correspondence": _Chart(_correspondence, "Where on the projector each camera pixel looks, "
        "and how far the stripes rise above their noise. Grey: not valid."),
    "rays": _Chart(_rays, "Camera pixels a ray, light of other rays that leaks into each, and a "
        "ray's noise. Grey: rays that the camera doesn't see. Views one above the other."),
    "symmetry": _Chart(_symmetry, "Left: pairs of random patterns, lit one way and the other. "
        "Right: the predicted error of relit pictures, and what is accepted. Bars are two "
        "standard errors."),
}  # fmt: skip
