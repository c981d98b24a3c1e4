"""The page of a rig's calibration: what each step found, with pictures and a verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.calibration import STEPS, CalibrationFolder
from rfpipe.calibration.base import Findings
from rfpipe.errors import StoreError
from rfpipe.report.blocks import Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.calibration_charts import (
    correspondence_figure,
    dark_figure,
    light_figure,
    linearity_figure,
    rays_figure,
    symmetry_figure,
    transfer_figure,
)
from rfpipe.report.page import write_page

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["build_calibration_report"]

_STANDINGS = {"good": "good", "poor": "NOT GOOD", "unknown": "can't tell"}

_CAPTIONS: dict[str, tuple[Callable[[Findings], Figure], str]] = {
    "dark": (
        dark_figure,
        (
            "Left: counts without light against the exposure time; the slope is the dark "
            "current and what light is left. Right: the black level of each photosite at "
            "the longest exposure."
        ),
    ),
    "linearity": (
        linearity_figure,
        (
            "Light by the shorter of two exposures over that by the longer one, less 1, "
            "against the longer one's counts as a fraction of full scale; bars are two "
            "standard errors."
        ),
    ),
    "light": (
        light_figure,
        (
            "Light of each code as a fraction of that of 255: median over the lit camera "
            "pixels, and the monotone curve through them. Right: what the curve adds to a "
            "gamma of 2.2."
        ),
    ),
    "transfer": (
        transfer_figure,
        (
            "Variance between two pictures of the same light against their mean signal, in "
            "counts: measured (filled: used) and the fit of read noise, photon noise and "
            "rounding. Right: measured over fitted; bars are two standard errors."
        ),
    ),
    "correspondence": (
        correspondence_figure,
        (
            "Where on the projector each camera pixel looks (x and y in projector pixels), "
            "and how far the stripes rise above their noise. Grey: not valid."
        ),
    ),
    "rays": (
        rays_figure,
        (
            "Camera pixels a ray; light of other rays that leaks into each, per unit of "
            "theirs; and the noise of a ray over that of a camera pixel. Views one above "
            "the other."
        ),
    ),
    "symmetry": (
        symmetry_figure,
        (
            "Left: pairs of random patterns, lit one way and the other; bars are two "
            "standard errors of the noise. Right: the error that asymmetry predicts for "
            "relit pictures, with two standard errors, and what is accepted."
        ),
    ),
}


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
    poor = [name for name, findings in found.items() if findings.verdict.standing == "poor"]
    lead = (
        f"Not good enough yet: {', '.join(STEPS[name].title.lower() for name in poor)}."
        if poor
        else "No step found a fault."
    )
    page = folder.path / "report.html"
    sections = [_summary(found), *(_section(name, of_step) for name, of_step in found.items())]
    write_page(page, "Calibration of the rig", lead, sections)
    return page


def _summary(found: dict[str, Findings]) -> Section:
    rows = [
        [STEPS[name].title, _STANDINGS[findings.verdict.standing]]
        for name, findings in found.items()
    ]
    table = Table([], ["step", "verdict"], rows, text_columns=2)
    caption = "What each step found; its reasons stand in its section."
    return Section("summary", "Verdicts", [Tabulation("Verdicts", caption, table, is_folded=False)])


def _section(name: str, findings: Findings) -> Section:
    title = STEPS[name].title
    draw, caption = _CAPTIONS[name]
    verdict = f"Verdict: {_STANDINGS[findings.verdict.standing]}. {findings.verdict.text}"
    labels = [("number", "number", str), ("value", "value", str)]
    table = table_of(_numbers(findings.facts), labels, [], csv=f"{name}.csv")
    return Section(
        name,
        title,
        [
            Illustration(title, caption, name, draw(findings)),
            Tabulation("Numbers", "Units stand in the names.", table),
        ],
        [verdict],
    )


def _numbers(facts: dict[str, Any]) -> pd.DataFrame:
    """Return the facts that are single numbers or texts, as a table."""
    import pandas as pd

    rows = [
        {"number": name, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
        for name, value in facts.items()
        if isinstance(value, bool | int | float | str)
    ]
    return pd.DataFrame(rows, columns=["number", "value"])
