"""What the thesis claims, and whether it holds here, with numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from rfpipe.report.blocks import Section, Tabulation, table_of
from rfpipe.report.figures.fits import line_fit
from rfpipe.report.inputs import Inputs, Study
from rfpipe.report.text import percent
from rfpipe.report.thesis import CLAIMS

__all__ = ["Verdict", "claims_section", "verdicts"]

_HOLDS, _PART, _NOT = "holds", "in part", "does not"
_FLAT = 0.15  # exponent of pixels below which growth counts as logarithmic
_GROWS = 0.6  # above which it is nearer to brute force
_STRAIGHT = 0.95  # variance that a line explains
_GOOD, _FAIR = 0.05, 0.2  # error of a picture


@dataclass(frozen=True)
class Verdict:
    """Whether a claim holds.

    Attributes
    ----------
    figure : str
        The thesis' figure or table.
    verdict : str
        "holds", "in part" or "does not".
    numbers : str
        What says so.
    """

    figure: str
    verdict: str
    numbers: str


def verdicts(studies: dict[str, Study]) -> list[Verdict]:
    """Judge the claims whose studies were made, by fixed limits on what they measured."""
    return [verdict for name, judge in _JUDGES.items() if name in studies
            for verdict in judge(studies[name].rows)]  # fmt: skip


def claims_section(inputs: Inputs) -> Section:
    """The table of claims."""
    found = [
        {**vars(each), "claim": CLAIMS.get(each.figure, "")} for each in verdicts(inputs.studies)
    ]
    table = table_of(
        found,
        [("", "figure", str), ("the thesis' claim", "claim", str), ("here", "verdict", str)],
        [("by these numbers", "numbers", str)],
        csv="claims.csv",
    )
    about = (
        "Judged by fixed limits: pictures within 5 % hold, within 20 % hold in part; growth is "
        "logarithmic where the exponent of pixels is below 0.15. At the size of this run, on our "
        "scenes; figures that aren't named here stand in their sections."
    )
    sources = [study.source for study in inputs.studies.values()]
    block = Tabulation("The thesis' claims", about, table, is_folded=False)
    return Section("claims", "The thesis' claims, and what holds here", [block], (), sources)


def _by_error(error: float, good: float = _GOOD, fair: float = _FAIR) -> str:
    return _HOLDS if error <= good else _PART if error <= fair else _NOT


def _walk(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    counts = {row["case"]: row["patterns"] for row in rows}
    holds = counts == {"without": 13, "with": 21}
    told = f"{counts['without']} patterns without conflicts, {counts['with']} with"
    yield Verdict("Fig. 3.1", _HOLDS if holds else _NOT, told)


def _box(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    kept = {row["case"]: row["kept"] for row in rows}
    pixel, hierarchy = kept["pixel"], kept["hierarchy"]
    verdict = _HOLDS if pixel < 0.5 and hierarchy > 0.9 else _PART if pixel < hierarchy else _NOT
    told = (
        f"inter-reflected light in the dual picture: {percent(pixel)} % at the pixel level, "
        f"{percent(hierarchy)} % with the hierarchy"
    )
    yield Verdict("Fig. 3.3", verdict, told)
    last = next(row for row in rows if row["case"] == "hierarchy")
    yield Verdict(
        "Fig. 3.4", _by_error(last["error"]), f"dual picture's error {percent(last['error'])} %"
    )


def _bottle(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    inside, outside = row["together_at_glass"], row["together_elsewhere"]
    if inside is not None and outside is not None:  # not so few pixels that none is at the bottle
        told = f"pixels lit together: {inside:.0f} where the bottle is, {outside:.0f} elsewhere"
        yield Verdict("Fig. 3.2", _HOLDS if inside < outside / 1.5 else _NOT, told)
    error = row["dual_matte_error"]
    told = (
        f"errors of pictures relit by the matte: primal {percent(row['primal_matte_relit_error'])} "
        f"%, dual {percent(error)} %"
    )
    yield Verdict("Fig. 3.6", _by_error(error), told)


def _samples(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    told = ", ".join(f"{row['world']} {percent(row['error'])} %" for row in rows)
    worst = max(row["error"] for row in rows)
    yield Verdict("Fig. 3.7", _by_error(worst), f"errors of dual pictures: {told}")


def _growth(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    import pandas as pd

    fits = {
        str(scene): line_fit(own) for scene, own in pd.DataFrame(rows).groupby("scene", sort=False)
    }
    exponent = max(fit["exponent"] for fit in fits.values())
    straight = min(fit["explained"] for fit in fits.values())
    logarithmic = exponent < _FLAT or (straight > _STRAIGHT and exponent < _GROWS)
    verdict = _HOLDS if logarithmic else _PART if exponent < _GROWS else _NOT
    told = "; ".join(
        f"{scene}: {fit['slope']:.0f} patterns a level ({fit['explained']:.0%} of the variance), "
        f"as pixels to the power {fit['exponent']:.2f}"
        for scene, fit in fits.items()
    )
    yield Verdict("Fig. 3.8", verdict, told)


def _arc(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    worst = max(row["error"], row["matte_error"])
    told = (
        f"{row['positions']} positions, {row['patterns']:,} patterns; area light's error "
        f"{percent(row['error'])} %, matte's {percent(row['matte_error'])} %, worst position's "
        f"{percent(row['worst'])} %"
    )
    yield Verdict("Fig. 3.9", _by_error(worst), told)


def _right_angles(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    verdict = _HOLDS if row["coarse"] > 0.1 else _NOT
    told = f"{percent(row['coarse'])} % of the dual picture's light stored at coarse levels"
    yield Verdict("Fig. 3.10", verdict, told)


def _bears(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    worst = max(row["letters_error"], row["both_error"])
    told = (
        f"errors: letters {percent(row['letters_error'])} %, with even light from behind "
        f"{percent(row['both_error'])} %; {row['patterns']:,} patterns for {row['rays']:,} rays"
    )
    yield Verdict("Fig. 5.6", _by_error(worst), told)
    errors = [level["error"] for level in row["levels"]]
    falling = sum(later < earlier for earlier, later in pairwise(errors))
    verdict = _HOLDS if falling == len(errors) - 1 else _PART if errors[-1] < errors[0] else _NOT
    told = "error by level: " + ", ".join(f"{percent(error)} %" for error in errors)
    yield Verdict("Fig. 5.7", verdict, told)
    share = row["patterns"] / row["rays"]
    told = f"{row['patterns']:,} patterns, {share:.0%} of brute force at this size"
    yield Verdict("Table 5.1", _HOLDS if share < 0.05 else _PART if share < 1 else _NOT, told)


def _flare(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    cases = {row["case"]: row for row in rows}
    tight, loose, without = (cases[name]["around"] for name in ("tight", "loose", "without"))
    verdict = _HOLDS if tight > 1.2 * loose else _PART if tight > 1.2 * without else _NOT
    told = (
        f"error at highlights: tight {percent(tight)} %, loose {percent(loose)} %, "
        f"without flare {percent(without)} %"
    )
    yield Verdict("Fig. 5.11", verdict, told)


_JUDGES: dict[str, Callable[[list[dict[str, Any]]], Iterator[Verdict]]] = {
    "walk": _walk,
    "bottle": _bottle,
    "box": _box,
    "samples": _samples,
    "growth": _growth,
    "arc": _arc,
    "right_angles": _right_angles,
    "bears": _bears,
    "flare": _flare,
}
