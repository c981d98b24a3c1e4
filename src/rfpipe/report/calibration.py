"""The page of a rig's calibration: each step's verdict, numbers and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.folder import STEPS, CalibrationFolder
from rfpipe.calibration.sight import YELLOW, sight_picture
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import StoreError
from rfpipe.report.drawing import Map, draw, new_figure
from rfpipe.report.page import Illustration, Section, Table, table_of, write_page
from rfpipe.report.text import STANDING_COLOURS
from rfpipe.rigs.calibrated import STANDINGS

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
    done = {name: folder.read(name) for name in STEPS if folder.is_done(name)}
    if not done:
        raise StoreError(f"{folder.path}: holds no calibration; run `rfpipe calibrate` first")
    read = {name: STANDINGS[findings.verdict.standing] for name, findings in done.items()}
    faults = [name for name, standing in read.items() if standing != STANDINGS["good"]]
    lead = "; ".join(f"{STEPS[name].title}: {read[name]}" for name in faults)
    rows = [[STEPS[name].title, standing] for name, standing in read.items()]
    table = Table("Verdicts", "", ["step", "verdict"], rows, 2, is_folded=False)
    reasons = [f"{STEPS[name].title}: {_verdict(done[name])}" for name in faults]
    sections = [_section(name, done) for name in sorted(done, key="scene".__ne__)]
    sections.insert(0, Section("verdicts", "Verdicts", [table], reasons))
    page, lead = folder.path / "report.html", lead or "No step found a fault."
    write_page(page, "Calibration of the rig", lead, sections, STANDING_COLOURS)
    return page


def _verdict(findings: Findings) -> str:
    return f"{STANDINGS[findings.verdict.standing]}. {findings.verdict.text}"


def _section(name: str, done: All) -> Section:
    title, findings = STEPS[name].title, done[name]
    verdict = f"Verdict: {_verdict(findings)}"
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
    chart, caption = _CHARTS[name]
    return Section(name, title, [Illustration(title, caption, name, chart(done)), table], [verdict])


def _plots(*labels: tuple[str, str]) -> tuple[Figure, NDArray[Any]]:
    """Return a figure of plots side by side, each with its labels below and on the left."""
    figure, (axes,) = new_figure(1, len(labels), (8.4 if len(labels) > 1 else 5.0, 3.1))
    for axis, (below, left) in zip(axes, labels, strict=True):
        axis.set(xlabel=below, ylabel=left)
    return figure, axes


def _maps(**images: NDArray[Any]) -> Figure:
    """Show maps side by side, each with its scale."""
    maps = [Map(image, scale=name.replace("_", " ")) for name, image in images.items()]
    return draw([maps], 2.6)


def _errors(axis: Axes, x: Any, y: Any, error: Any, **style: Any) -> None:
    """Draw measurements with bars of two standard errors."""
    axis.errorbar(x, y, 2 * error, **{"color": _BLUE, "linewidth": 0.8, **_DOTS, **style})


def _latency(done: All) -> Figure:
    one = done["latency"]
    figure, (axis,) = _plots(("wait after a picture was drawn, ms", "share of the step seen"))
    axis.plot(1000 * one["waits"], one["worst"], color=_BLUE, **_DOTS)
    axis.axvline(1000 * one["settle_seconds"], color=_GREY, linestyle="--")
    axis.set_ylim(-0.1, 1.1)
    return figure


def _scene(done: All) -> Figure:
    one = done["scene"]
    sight = Map(sight_picture(one["white"], one["saturated"], one["dark"]), "white, less black")
    dark = Map(one["black"], "all off", scale="counts")
    focus = Map(one["focus"], "contrast of stripes", scale="contrast")
    figure = draw([[sight, dark, focus]], 2.6)
    left, lit = figure.axes[0], one["lit"]
    if lit.any() and not lit.all():
        left.contour(lit.astype(float), levels=[0.5], colors=[YELLOW], linewidths=1.2)
    if "valid" in done.get("correspondence", one).arrays:
        seen = done["correspondence"]
        for name in "xy":
            where = np.where(seen["valid"], seen[name], np.nan)
            left.contour(where, levels=8, colors=_CYAN, linewidths=0.5)
    return figure


def _dark(done: All) -> Figure:
    one = done["dark"]
    figure, (left, right) = _plots(("exposure, s", "mean without light, counts"), ("", ""))
    times = np.array(one["exposures_s"])
    left.plot(times, one["level_counts"], "o", color=_BLUE)
    left.plot(times, one["black_level_counts"] + one["current_counts_per_s"] * times, **_FIT)
    left.ticklabel_format(axis="y", useOffset=False)
    longest = one["black"][-1]
    shown = right.imshow(longest if longest.ndim == 2 else longest.mean(axis=-1))
    figure.colorbar(shown, ax=right, shrink=0.8, label="counts")
    return figure


def _linearity(done: All) -> Figure:
    one = done["linearity"]
    figure, (axis,) = _plots(("counts above black, fraction of full scale", "deviation, %"))
    axis.axhline(0, color=_GREY, linewidth=0.8)
    _errors(axis, one["level"], 100 * one["deviation"], 100 * one["error"])
    axis.set_xscale("log")
    return figure


def _light(done: All) -> Figure:
    one = done["light"]
    figure, (axis,) = _plots(("code", "light, fraction of code 255"))
    axis.plot(np.arange(256), one["light"], **_FIT)
    _errors(axis, one["codes"], one["measured"], one["error"])
    return figure


def _transfer(done: All) -> Figure:
    one = done["transfer"]
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


def _correspondence(done: All) -> Figure:
    one = done["correspondence"]
    x, y, above = (np.where(one["valid"], one[name], np.nan) for name in ("x", "y", "modulation"))
    return _maps(x__projector_pixels=x, y__projector_pixels=y, stripes_over_noise=above)


def _rays(done: All) -> Figure:
    one = done["rays"]
    seen = np.diff(one["resampling_starts"]).reshape(one["pixels"].shape) > 0
    pixels, leak, noise = (
        np.where(seen, one[name], np.nan).reshape(-1, seen.shape[-1])
        for name in ("pixels", "leak", "noise")
    )
    return _maps(camera_pixels_a_ray=pixels, leak__share=leak, noise_over_a_pixel_s=noise)


def _symmetry(done: All) -> Figure:
    one = done["symmetry"]
    figure, (axis,) = _plots(("", "predicted error of relit pictures, %"))
    axis.axhline(100 * one["tolerance"], **_FIT)
    _errors(axis, ["asymmetry"], [100 * one["error"]], 100 * one["standard_error"])
    axis.set_ylim(bottom=0)
    return figure


class _Chart(NamedTuple):
    draw: Callable[[All], Figure]
    caption: str


_CHARTS: dict[str, _Chart] = {
    "latency": _Chart(_latency, "The least share of the step from one picture to the next that "
        "the camera's first exposure saw. Dashed: what the settings wait."),
    "scene": _Chart(_scene, "Red: saturated at all exposures; blue: within the noise at all; "
        "yellow: the projector's outline; thin: its rows and columns. All off: at the longest "
        "exposure."),
    "dark": _Chart(_dark, "Counts without light, whose slope is dark current and leaking light; "
        "and each photosite's at the longest exposure."),
    "linearity": _Chart(_linearity, "Light by the shorter of two exposures over that by the "
        "longer one, less 1; bars are two standard errors."),
    "light": _Chart(_light, "Light of each code: median over the lit camera pixels, and the "
        "monotone curve through them."),
    "transfer": _Chart(_transfer, "Variance between two pictures of the same light (filled: "
        "used), and the fit of read noise, photon noise and rounding."),
    "correspondence": _Chart(_correspondence, "Where on the projector each camera pixel looks, "
        "and how far the stripes rise above their noise."),
    "rays": _Chart(_rays, "Camera pixels a ray, light of other rays that leaks into each, and a "
        "ray's noise. Views one above the other."),
    "symmetry": _Chart(_symmetry, "The error that asymmetry makes in relit pictures, and what "
        "is accepted; bars are two standard errors."),
}  # fmt: skip
