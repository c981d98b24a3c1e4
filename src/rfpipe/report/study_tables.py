"""The tables of the studies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.report import methods
from rfpipe.report.blocks import Table, table_of
from rfpipe.report.inputs import Study
from rfpipe.report.text import fixed, number, percent, size, words

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["mosaic_table", "resolution_table", "stability_table"]


def resolution_table(study: Study) -> tuple[Table, pd.DataFrame]:
    """Return patterns by method and resolution."""
    import pandas as pd

    numbers = pd.DataFrame(study.rows)
    sides = sorted(set(numbers["side"]))
    patterns = numbers.set_index(["method", "side"])["patterns"]
    rows = [
        [methods.title(method), *(number(patterns[method, side]) for side in sides)]
        for method in dict.fromkeys(numbers["method"])
    ]
    columns = ["method", *(size(side, side) for side in sides)]
    return Table([], columns, rows, csv="resolution.csv"), numbers


def stability_table(study: Study) -> tuple[Table, pd.DataFrame]:
    """Return the hard cases with patterns and errors by method."""
    import pandas as pd

    def refusal(reason: str) -> str:
        return f"refused: {reason.split(':', maxsplit=1)[0]}" if reason else ""

    table = table_of(
        study.rows,
        [
            ("case", "case", words),
            ("method", "method", methods.title),
            ("camera", "camera", str),
            ("patterns", "patterns", number),
            ("brute force", "rays", number),
            ("of T", "matrix_error", _scientific),
            ("of an image", "relight_error", _scientific),
            ("of float32 sums", "accumulation", _scientific),
            ("", "refused", refusal),
        ],
        [("", 5), ("relative error", 3), ("", 1)],
        text_columns=3,
        csv="stability.csv",
        is_grouped=True,
    )
    return table, pd.DataFrame(study.rows)


def _scientific(value: float | None) -> str:
    return number(value, ".1e")


def mosaic_table(study: Study) -> tuple[Table, pd.DataFrame]:
    """Return what normalization does to single-pixel images."""
    import pandas as pd

    chains = {"linear": "whole bracket, linear", "median": "short exposure, median"}
    table = table_of(
        study.rows,
        [
            ("interpolation", "chain", lambda chain: chains[chain]),
            ("normalization", "normalization", words),
            ("light", "energy", fixed(1, 100)),
            ("colour contrast", "colour_contrast", fixed(1, 100)),
            ("of the sum", "rms", percent),
            ("of single images", "image_error", fixed(0, 100)),
        ],
        [("", 2), ("sum, % of floodlit", 2), ("relative error, %", 2)],
        text_columns=2,
        csv="mosaic.csv",
        is_grouped=True,
    )
    return table, pd.DataFrame(study.rows)
