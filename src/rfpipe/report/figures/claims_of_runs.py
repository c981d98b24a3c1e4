"""What the thesis claims of scenes I to IV, judged by the run's acquisitions of them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report import methods
from rfpipe.report.charts import has_leaves_of_nodes
from rfpipe.report.figures.verdict import (
    FAIR,
    GOOD,
    HOLDS,
    NOT,
    PART,
    Verdict,
    by_error,
    worst,
)
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import percent
from rfpipe.report.thesis import numeral_of
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms
from rfpipe.stages.evaluating.slices import NO_LEAF
from rfpipe.stages.relight import right_half

__all__ = ["verdicts"]

_FIRST = 3  # the thesis' level 4: it counts from 1
_SIGNIFICANT = 0.1  # of the leaves
_FAR_MORE = 2.0  # times as many
_SPARSE_LEVELS = 3  # the thesis' 6 to 8 of 10: those before the last ones
_AROUND = 3  # pixels a side: what varies within is fine detail

_Runs = dict[str, Run]
"""Runs of a method by their scene's number in Fig. 2.1."""


def verdicts(inputs: Inputs) -> Iterator[Verdict]:
    """Judge Fig. 2.1, 5.9 and 5.10, where the scenes were acquired by the methods compared."""
    symmetric, dual = (_of_table(inputs, number) for number in ("5.1", "3.1"))
    if {"I", "II", "IV"} <= symmetric.keys():
        yield _matrices(symmetric, dual)
    if "IV" in symmetric and "IV" in dual:
        yield _methods(symmetric["IV"], dual["IV"])
    if {"I", "II"} <= symmetric.keys() and all(map(has_leaves_of_nodes, symmetric.values())):
        yield _leaves(symmetric)


def _of_table(inputs: Inputs, number: str) -> _Runs:
    chosen = methods.of_table(number, inputs.methods)
    runs = [run for run in inputs.runs if run.method in chosen]
    named = {numeral_of(run.settings): run for run in runs}
    return {numeral: run for numeral, run in named.items() if numeral}


def _matrices(symmetric: _Runs, dual: _Runs) -> Verdict:
    """Fig. 2.1: symmetric; diagonal for a plane; of rank 1 from plane to plane, textured or not."""
    found, told = [], []
    if "IV" in dual:  # a method that doesn't assume it
        asymmetry = max(
            _asymmetry(run.read("line_relit")) for run in dual.values() if run.has_indirect_light
        )
        found.append(by_error(asymmetry))
        told.append(
            "indirect light in T by dual photography differs from its transpose by "
            f"{percent(asymmetry)} % at most"
        )
    line = symmetric["I"].read("line_relit").sum(axis=-1)
    aside = abs(float(1 - np.trace(line) / line.sum()))
    found.append(by_error(aside))
    told.append(f"scene I: {percent(aside)} % of T beside the diagonal")
    walls = {name: run for name, run in symmetric.items() if name != "I" and run.has_leaf_levels}
    coarse = {name: _held_coarsely(run) for name, run in walls.items()}
    found += [by_error(1 - share) for share in coarse.values()]
    told.append(
        "entries from plane to plane held in rank-1 leaves larger than a ray: "
        + ", ".join(f"{name} {percent(share)} %" for name, share in coarse.items())
    )
    alike = min((_alike(*pair) for pair in combinations(walls.values(), 2)), default=1.0)
    found.append(by_error(1 - alike))
    told.append(f"subdivided to the same level, or the next, with any texture: {percent(alike)} %")
    return Verdict("Fig. 2.1", worst(found), "; ".join(told))


def _asymmetry(entries: NDArray[Any]) -> float:
    """Return how far a matrix (W, W, C), but its diagonal, is from its transpose; relative."""
    aside = entries * (1 - np.eye(len(entries)))[..., None]
    return relative_rms(aside.swapaxes(0, 1), aside)


def _across(image: NDArray[Any]) -> NDArray[Any]:
    """Return what goes from the left plane to the right one, but for the middle column."""
    half = len(image) // 2
    return image[len(image) - half :, :half]


def _held_coarsely(run: Run) -> float:
    """Return the share of the entries from plane to plane that are in no leaf of single rays."""
    levels = _across(run.read("line_levels"))
    lit = _across(run.read("line_truth")).sum(axis=-1) > 0
    last = max(int(row["level"]) for row in run.facts["levels"])
    return float(((levels != NO_LEAF) & (levels < last))[lit].mean())


def _alike(one: Run, other: Run) -> float:
    """Return the share of entries from plane to plane held at the same level, or the next."""
    first, second = (_across(run.read("line_levels")).astype(int) for run in (one, other))
    return float((np.abs(first - second) <= 1).mean())


def _methods(symmetric: Run, dual: Run) -> Verdict:
    """Fig. 5.9: fewer patterns, and the fine texture in indirect light, which dual blurs."""
    pattern = right_half(symmetric.settings.shape)
    truth = symmetric.read("half_truth")
    pictures = [run.read("half_relit") for run in (symmetric, dual)]
    ours, theirs = (_detail(picture, truth, pattern == 0) for picture in pictures)
    errors = [unlit_rms(picture, truth, pattern) for picture in pictures]
    is_fewer = symmetric.patterns < dual.patterns
    is_sharper = ours >= 1 - GOOD and theirs < 1 - FAIR
    verdict = HOLDS if is_fewer and is_sharper else PART if is_fewer or is_sharper else NOT
    told = (
        f"scene IV: symmetric photography {symmetric.patterns:,} patterns, dual "
        f"{dual.patterns:,}; fine detail of indirect light kept {percent(ours)} % and "
        f"{percent(theirs)} %, its error {percent(errors[0])} % and {percent(errors[1])} %"
    )
    return Verdict("Fig. 5.9", verdict, told)


def _detail(picture: NDArray[Any], truth: NDArray[Any], where: NDArray[np.bool_]) -> float:
    """Return which share of the true picture's fine detail is in a picture: 0 for a blurred one."""
    ours, true = (_fine(image)[where] for image in (picture, truth))
    return float((ours * true).sum() / (true * true).sum())


def _fine(image: NDArray[Any]) -> NDArray[np.float64]:
    """Return a picture (H, W, C) without what is smooth in it."""
    from scipy.ndimage import uniform_filter

    exact = np.asarray(image, np.float64)
    return exact - uniform_filter(exact, size=(_AROUND, _AROUND, 1), mode="nearest")


def _leaves(symmetric: _Runs) -> Verdict:
    """Fig. 5.10: many leaves of rank 1, and more empty nodes for a plane than for two walls."""
    shares = {name: _share_of_rank_1(run) for name, run in symmetric.items()}
    seen = [share for own in shares.values() for share in own]
    significant = sum(share >= _SIGNIFICANT for share in seen)
    plane, walls = (_empty(symmetric[name]) for name in ("I", "II"))
    pairs = list(zip(plane, walls, strict=False))[-_SPARSE_LEVELS:]
    far_more = all(one >= _FAR_MORE * other for one, other in pairs)
    more = all(one > other for one, other in pairs)
    of_rank_1 = HOLDS if significant == len(seen) else PART if significant else NOT
    of_empty = HOLDS if far_more else PART if more else NOT
    told = (
        f"from level {_FIRST} to the last but one a tenth of the leaves or more is of rank 1 at "
        f"{significant} of {len(seen)} levels ("
        + "; ".join(
            f"{name}: {', '.join(f'{percent(share)} %' for share in own)}"
            for name, own in shares.items()
        )
        + "); empty nodes, I against II: "
        + ", ".join(f"{percent(one)} against {percent(other)} %" for one, other in pairs)
    )
    return Verdict("Fig. 5.10", worst([of_rank_1, of_empty]), told)


def _levels(run: Run) -> list[dict[str, Any]]:
    """Return the levels from the thesis' fourth to that before single rays."""
    rows = [row for row in run.facts["levels"] if row["nodes"]]
    return [row for row in rows[:-1] if int(row["level"]) >= _FIRST]


def _share_of_rank_1(run: Run) -> list[float]:
    """Return by level the share of the leaves that is of rank 1, or of another low rank."""
    shares = []
    for row in _levels(run):
        low = row["rank1"] + row.get("rank_k", 0)
        shares.append(low / max(low + row["empty"], 1))
    return shares


def _empty(run: Run) -> list[float]:
    """Return by level the share of empty nodes."""
    return [row["empty"] / row["nodes"] for row in _levels(run)]
