"""The tables of the studies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.report.inputs import METHOD_TITLES, Study
from rfpipe.report.tables import Table
from rfpipe.report.text import number, percent, size

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
        [METHOD_TITLES[method], *(number(patterns[method, side]) for side in sides)]
        for method in dict.fromkeys(numbers["method"])
    ]
    columns = ["method", *(size(side, side) for side in sides)]
    return Table([], columns, rows, csv="resolution.csv"), numbers


def stability_table(study: Study) -> tuple[Table, pd.DataFrame]:
    """Return the hard cases with patterns and errors by method."""
    import pandas as pd

    rows = []
    previous = ""
    for row in study.rows:
        refused = str(row["refused"]).split(":")[0]
        rows.append(
            [
                "" if row["case"] == previous else row["case"].replace("_", " "),
                METHOD_TITLES[row["method"]],
                row["camera"],
                number(row["patterns"]),
                number(row["rays"]),
                number(row["matrix_error"], ".1e"),
                number(row["relight_error"], ".1e"),
                number(row["accumulation"], ".0e"),
                f"refused: {refused}" if refused else "",
            ]
        )
        previous = row["case"]
    table = Table(
        [("", 5), ("relative error", 3), ("", 1)],
        ["case", "method", "camera", "patterns", "brute force", "of T", "of an image",
         "of float32 sums", ""],
        rows,
        text_columns=3,
        csv="stability.csv",
    )  # fmt: skip
    return table, pd.DataFrame(study.rows)


def mosaic_table(study: Study) -> tuple[Table, pd.DataFrame]:
    """Return what normalization does to single-pixel images."""
    import pandas as pd

    chains = {"linear": "whole bracket, linear", "median": "short exposure, median"}
    rows = [
        [
            chains[row["chain"]],
            row["normalization"].replace("_", " "),
            number(row["energy"], ".1f", 100),
            number(row["colour_contrast"], ".1f", 100),
            percent(row["rms"]),
            number(row["image_error"], ".0f", 100),
        ]
        for row in study.rows
    ]
    table = Table(
        [("", 2), ("sum, % of floodlit", 2), ("relative error, %", 2)],
        ["interpolation", "normalization", "light", "colour contrast", "of the sum",
         "of single images"],
        rows,
        text_columns=2,
        csv="mosaic.csv",
    )  # fmt: skip
    return table, pd.DataFrame(study.rows)
