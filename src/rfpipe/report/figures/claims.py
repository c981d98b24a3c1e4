"""What the thesis claims, and whether it holds here, with numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from rfpipe.report.blocks import Section, Tabulation, table_of
from rfpipe.report.figures import claims_of_runs
from rfpipe.report.figures.costs import cost_rows
from rfpipe.report.figures.fits import line_fit
from rfpipe.report.figures.verdict import (
    GOOD,
    HOLDS,
    NOT,
    PART,
    Verdict,
    by_error,
)
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import percent
from rfpipe.report.thesis import CLAIMS

__all__ = ["claims_section", "verdicts"]

_STRAIGHT = 0.95  # variance that a line explains
_NEARER = 2.0  # growth of a level's patterns: 1 is a straight line, 4 brute force, this between
_ORDERS = 2  # of magnitude: "several" in Table 3.1, "about 2" in Table 5.1
_CORRUPTED = 1.2  # times the error of a looser threshold, and of a lens without flare
_DIM = 0.95  # of the floodlit image's light, or colour: what is less is dimmer, or paler


def verdicts(inputs: Inputs) -> list[Verdict]:
    """Judge the claims that something was measured for, by fixed limits, in the thesis' order."""
    studies = inputs.studies
    found = [verdict for name, judge in _JUDGES.items() if name in studies
             for verdict in judge(studies[name].rows)]  # fmt: skip
    found += [*_costs(cost_rows(inputs)), *claims_of_runs.verdicts(inputs)]
    return sorted(found, key=lambda verdict: list(CLAIMS).index(verdict.figure))


def claims_section(inputs: Inputs) -> Section:
    """The table of claims."""
    found = [{**vars(each), "claim": CLAIMS.get(each.figure, "")} for each in verdicts(inputs)]
    table = table_of(
        found,
        [("", "figure", str), ("the thesis' claim", "claim", str), ("here", "verdict", str)],
        [("by these numbers", "numbers", str)],
        csv="claims.csv",
    )
    about = (
        "Judged by fixed limits, at the size of this run and on our scenes. Pictures and shares "
        "within 5 % hold, within 20 % hold in part; of several parts the worst counts. Growth is "
        "logarithmic where a line explains 95 % of it and the last level takes at most twice the "
        "patterns of the one before (a line: as many; brute force: four times as many), in part "
        "where only the latter is so. Orders of magnitude are two or more, rounded in Table 5.1, "
        "where the thesis says about two; one is in part."
    )
    sources = [study.source for study in inputs.studies.values()]
    block = Tabulation("The thesis' claims", about, table, is_folded=False)
    return Section("claims", "The thesis' claims, and what holds here", [block], (), sources)


def _walk(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    counts = {row["case"]: row["patterns"] for row in rows}
    holds = counts == {"without": 13, "with": 21}
    told = f"{counts['without']} patterns without conflicts, {counts['with']} with"
    yield Verdict("Fig. 3.1", HOLDS if holds else NOT, told)


def _box(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    kept = {row["case"]: row["kept"] for row in rows}
    pixel, hierarchy = kept["pixel"], kept["hierarchy"]
    verdict = HOLDS if pixel < 0.5 and hierarchy > 0.9 else PART if pixel < hierarchy else NOT
    told = (
        f"inter-reflected light in the dual picture: {percent(pixel)} % at the pixel level, "
        f"{percent(hierarchy)} % with the hierarchy"
    )
    yield Verdict("Fig. 3.3", verdict, told)
    last = next(row for row in rows if row["case"] == "hierarchy")
    yield Verdict(
        "Fig. 3.4", by_error(last["error"]), f"dual picture's error {percent(last['error'])} %"
    )


def _bottle(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    inside, outside = row["together_at_glass"], row["together_elsewhere"]
    if inside is not None and outside is not None:  # not so few pixels that none is at the bottle
        told = f"pixels lit together: {inside:.0f} where the bottle is, {outside:.0f} elsewhere"
        yield Verdict("Fig. 3.2", HOLDS if inside < outside / 1.5 else NOT, told)
    error = row["dual_matte_error"]
    told = (
        f"errors of pictures relit by the matte: primal {percent(row['primal_matte_relit_error'])} "
        f"%, dual {percent(error)} %"
    )
    yield Verdict("Fig. 3.6", by_error(error), told)


def _samples(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    told = ", ".join(f"{row['world']} {percent(row['error'])} %" for row in rows)
    largest = max(row["error"] for row in rows)
    yield Verdict("Fig. 3.7", by_error(largest), f"errors of dual pictures: {told}")


def _growth(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    import pandas as pd

    told, straight, slow = [], [], []
    for scene, own in pd.DataFrame(rows).groupby("scene", sort=False):
        fit, patterns = line_fit(own), list(own["patterns"])
        added = [later - earlier for earlier, later in pairwise(patterns)]
        growth = added[-1] / added[-2] if len(added) > 1 else float("nan")
        capped = int((own["patterns"] >= own["blocks"]).sum())
        straight.append(fit["explained"] >= _STRAIGHT)
        slow.append(growth <= _NEARER)
        told.append(
            f"{scene}: {', '.join(f'{count:,}' for count in patterns)} patterns at "
            f"{own['side'].iloc[0]} to {own['side'].iloc[-1]} a side, {capped} of these sizes as "
            f"brute force; a line explains {fit['explained']:.0%}; the last level takes "
            f"{growth:.2f} times the patterns of the one before"
        )
    verdict = HOLDS if all(straight) and all(slow) else PART if all(slow) else NOT
    yield Verdict("Fig. 3.8", verdict, "; ".join(told))


def _arc(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    worst = max(row["error"], row["matte_error"])
    told = (
        f"{row['positions']} positions, {row['patterns']:,} patterns; area light's error "
        f"{percent(row['error'])} %, matte's {percent(row['matte_error'])} %, worst position's "
        f"{percent(row['worst'])} %"
    )
    yield Verdict("Fig. 3.9", by_error(worst), told)


def _right_angles(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    verdict = HOLDS if row["coarse"] > 0.1 else NOT
    told = f"{percent(row['coarse'])} % of the dual picture's light stored at coarse levels"
    yield Verdict("Fig. 3.10", verdict, told)


def _bears(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    worst = max(row["letters_error"], row["both_error"])
    told = (
        f"errors: letters {percent(row['letters_error'])} %, with even light from behind "
        f"{percent(row['both_error'])} %; {row['patterns']:,} patterns for {row['rays']:,} rays"
    )
    yield Verdict("Fig. 5.6", by_error(worst), told)
    errors = [level["error"] for level in row["levels"]]
    falling = sum(later < earlier for earlier, later in pairwise(errors))
    verdict = HOLDS if falling == len(errors) - 1 else PART if errors[-1] < errors[0] else NOT
    told = "error by level: " + ", ".join(f"{percent(error)} %" for error in errors)
    yield Verdict("Fig. 5.7", verdict, told)


def _views(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    row = rows[0]
    errors = [error for of_light in row["errors"] for error in of_light]
    largest = max(*errors, row["matte_error"])
    moves = min(row["light_moves"], row["view_moves"])
    told = (
        f"errors of {len(errors)} pictures, a view in a view's light: up to "
        f"{percent(max(errors))} %; in a matte from aside {percent(row['matte_error'])} %. Another "
        f"light changes the picture by {percent(row['light_moves'])} % at least, another view by "
        f"{percent(row['view_moves'])} %"
    )
    yield Verdict("Fig. 5.8", by_error(largest) if moves > largest else NOT, told)


def _mosaic(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    told, found = [], []
    for chain, name in (("linear", "whole bracket, linear"), ("median", "short, median")):
        sums = {row["normalization"]: row for row in rows if row["chain"] == chain}
        bare = sums.pop("none")
        restored = max(row["rms"] for row in sums.values())
        is_worse = bare["energy"] < _DIM and bare["colour_contrast"] < _DIM
        found.append(is_worse and restored <= GOOD)
        told.append(
            f"{name}: the sum has {percent(bare['energy'])} % of the light and "
            f"{percent(bare['colour_contrast'])} % of the colour contrast; normalized it is within "
            f"{percent(restored)} % of the floodlit image"
        )
    yield Verdict("Fig. B.1", HOLDS if all(found) else PART if any(found) else NOT, "; ".join(told))


def _costs(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    """Tables 3.1 and 5.1, judged by their worst row."""
    dual = [row for row in rows if row["table"] == "3.1"]
    if dual:
        faster = min(row["brute_force_days"] * 24 * 60 / row["minutes"] for row in dual)
        smaller = min(row["dense_terabytes"] * 1e6 / row["megabytes"] for row in dual)
        least = min(faster, smaller)
        told = (
            f"of {len(dual)} rows the worst takes {faster:.2g} times less time and "
            f"{smaller:.2g} times less space than brute force, at this size"
        )
        verdict = HOLDS if least >= 10**_ORDERS else PART if least >= 10 else NOT
        yield Verdict("Table 3.1", verdict, told)
    symmetric = [row for row in rows if row["table"] == "5.1"]
    if symmetric:
        fewer = {row["figure"]: row["scan"] / row["patterns"] for row in symmetric}
        least = min(fewer.values())
        told = "times fewer patterns than brute force, at this size: " + ", ".join(
            f"{factor:.1f} ({figure})" for figure, factor in fewer.items()
        )
        orders = round(float(np.log10(least)))
        verdict = HOLDS if orders >= _ORDERS else PART if orders else NOT
        yield Verdict("Table 5.1", verdict, told)


def _flare(rows: list[dict[str, Any]]) -> Iterator[Verdict]:
    cases = {row["case"]: row for row in rows}
    tight, loose, without = (cases[name]["around"] for name in ("tight", "loose", "without"))
    parts = [tight > _CORRUPTED * loose, tight > _CORRUPTED * without]
    verdict = HOLDS if all(parts) else PART if any(parts) else NOT
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
    "views": _views,
    "mosaic": _mosaic,
}
