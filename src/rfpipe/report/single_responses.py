"""Why dual photography's pictures are as wrong as they are [3.2]."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report import methods
from rfpipe.report.blocks import Section, Table, Tabulation, table_of
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import number, percent, size, words
from rfpipe.scenes import CREASE
from rfpipe.stages.evaluating.metrics import relative_rms

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["error_sources", "single_responses_section"]

_SIDE = 8
"""Pixels over whose squares errors are averaged: noise falls to an eighth, what blocks do stays."""


def single_responses_section(inputs: Inputs) -> Section | None:
    """Explain the errors of a method that stores each pixel's responses one by one."""
    names = methods.of_table("3.1", inputs.methods)
    own = [run for run in inputs.runs if run.method in names]
    if not own:
        return None
    scenes = {run.scene for run in own}
    numbers = error_sources([run for run in inputs.runs if run.scene in scenes])
    worst = set(numbers[numbers["method"].isin(names)]["worst_pattern"])
    caption = (
        "Mean relative RMS error over the relighting patterns, on the pixels that a pattern leaves "
        "dark (on all of a camera that looks from aside): pixel by pixel, and of the pictures "
        f"averaged over {size(_SIDE, _SIDE)} pixels, where independent noise falls to an eighth "
        "and what blocks do to the light stays. And the pattern that a method relights worst, with "
        "its error and the light that comes out too much or too little."
    )
    name = methods.title(own[0].method)
    table = _sources_table(numbers, inputs)
    return Section(
        "single_responses",
        f"Why {name[0].lower()}{name[1:]} errs as it does",
        [Tabulation("Blocks or noise", caption, table, is_folded=False)],
        [_explanation(own, worst)],
        [run.source for run in inputs.runs if run.scene in scenes],
    )


def _explanation(runs: list[Run], worst: set[str]) -> str:
    crease = (
        " A strip along a crease suffers most: the blocks that touch it hand on the light of their "
        "whole width."
        if CREASE in worst
        else ""
    )
    levels = [row for run in runs for row in run.facts["levels"]]
    in_blocks = sum(row["rank1"] for row in levels)
    stored = in_blocks + sum(row["scalar"] for row in levels)
    text = (
        "A camera pixel's response to a block of projector pixels is one number, stored as soon as "
        "it falls below the threshold, and no finer: "
        f"{percent(in_blocks / stored if stored else None)} % of the responses here are those of "
        "whole blocks. A pattern that cuts through such a block gets the block's mean, whatever "
        "texture or edge lies within it, weighted where the rig is coaxial by what the block's own "
        f"pixels saw of the pixel's block.{crease} And each number is a single pixel's "
        "measurement with all of its noise, where symmetric photography takes whole images of a "
        "block, on both sides, as the factors of a leaf."
    )
    if not all(run.facts["options"].get("subtract_stored", True) for run in runs):
        text += (
            " As in the thesis' pseudocode, what was stored for a coarse block is not taken out of "
            "the finer levels' images and can count twice, which shows as bright patches."
        )
    return text


def error_sources(runs: list[Run]) -> pd.DataFrame:
    """Tell errors of single pixels from those that averaging over neighbours leaves.

    Parameters
    ----------
    runs : list of Run
        Of scenes whose truth is known.

    Returns
    -------
    DataFrame
        For each run with light to compare ``scene``, ``method``; ``error`` and ``error_averaged``,
        means over the relighting patterns, relative RMS; ``worst_pattern``, ``worst_error``, and
        ``worst_light``: light in that picture over the true one's, less 1.
    """
    import pandas as pd

    rows: list[dict[Any, Any]] = []
    for run in runs:
        pictures = zip(
            run.facts["names"],
            *(run.read(name) for name in ("patterns", "relit", "truth")),
            strict=True,
        )
        found = pd.DataFrame([_of_picture(run, *picture) for picture in pictures]).dropna()
        if found.empty:
            continue
        worst = found.iloc[int(found["error"].argmax())].add_prefix("worst_").to_dict()
        means = found[["error", "error_averaged"]].mean().to_dict()
        rows.append({"scene": run.scene, "method": run.method, **means, **worst})
    columns = ["error", "error_averaged", "worst_pattern", "worst_error", "worst_light"]
    return pd.DataFrame(rows, columns=["scene", "method", *columns])


def _of_picture(
    run: Run, name: str, pattern: NDArray[Any], relit: NDArray[Any], truth: NDArray[Any]
) -> dict[str, Any]:
    if run.is_coaxial:
        dark = (pattern == 0)[..., None]
        relit, truth = relit * dark, truth * dark
    light = float(truth.sum(dtype=np.float64))
    return {
        "pattern": name,
        "error": relative_rms(relit, truth),
        "error_averaged": relative_rms(_averaged(relit), _averaged(truth)),
        "light": float(relit.sum(dtype=np.float64)) / light - 1 if light > 0 else math.nan,
    }


def _averaged(image: NDArray[Any]) -> NDArray[np.float64]:
    """Add images (..., H, W, C) up over squares of pixels; those at the edge may be smaller."""
    sums = np.asarray(image, np.float64)
    for axis in (-3, -2):
        sums = np.add.reduceat(sums, np.arange(0, image.shape[axis], _SIDE), axis=axis)
    return sums


def _sources_table(numbers: pd.DataFrame, inputs: Inputs) -> Table:
    return table_of(
        numbers,
        inputs.labels,
        [
            ("single pixels", "error", percent),
            ("averaged", "error_averaged", percent),
            ("pattern", "worst_pattern", words),
            ("error", "worst_error", percent),
            ("light", "worst_light", partial(number, form="+.1f", scale=100)),
        ],
        [("", 2), ("mean error, %", 2), ("worst, %", 3)],
        csv="error_sources.csv",
    )
