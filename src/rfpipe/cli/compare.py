"""``rfpipe compare``: cost of the methods of finished runs at equal error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.report.page import Table

_HEADINGS = {
    "scene": "scene", "error": "error, %", "method": "method", "patterns": "patterns",
    "pictures": "pictures on the rig", "seconds": "seconds", "note": "note",
}  # fmt: skip


def compare(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="FOLDER...", help="Folders of finished runs, or of their results."),
    ],
    errors: Annotated[
        list[float] | None,
        typer.Option(
            "--error",
            "-e",
            help="Mean relative error of relit pictures at which to compare, a fraction such as "
            "0.01; may be repeated. By default several from 0.05 to 0.001, as far as at least one "
            "method reaches them.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds-per-pattern",
            min=0,
            help="Seconds that the rig needs for a picture; by default the runs' setting "
            "capture.seconds_per_pattern.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File for the table: .csv, or .tex for LaTeX."),
    ] = None,
) -> None:
    """Compare methods at equal error: patterns, pictures on the rig and seconds for each scene.

    The acquisitions of a scene by one method, at several tolerances or target errors and from any
    of the runs, form a curve of cost against error, with a point per level where the method has
    levels. Costs are interpolated on this curve. A note marks errors that a method did not reach.
    """
    from rfpipe.errors import InputError
    from rfpipe.output import checked_output
    from rfpipe.report.compare import ERRORS
    from rfpipe.report.compare import compare as costs_at_errors
    from rfpipe.report.page import latex_table
    from rfpipe.store.files import write_atomically

    for error in errors or ():
        if not 0 < error < 1:
            example = f"; for {error:g} % write {error / 100:g}" if 1 <= error < 100 else ""
            raise InputError(
                f"--error {error:g}: should be a fraction above 0 and below 1{example}"
            )
    suffix = checked_output("compare", output) if output is not None else ""
    rows = costs_at_errors(folders, errors or ERRORS, seconds)
    if errors is None:
        reached = rows["patterns"].notna().groupby(rows["error"]).transform("any")
        rows = rows[reached] if reached.any() else rows
    table = _text_table(rows)
    typer.echo(_aligned(table))
    if output is not None:
        text = rows.to_csv(index=False, float_format="%.6g", lineterminator="\n")
        content = (latex_table(table) if suffix == ".tex" else text).encode()
        write_atomically(output, content, resumes=False)
        typer.echo(f"\nwritten: {output}")


def _text_table(rows: pd.DataFrame) -> Table:
    """Format the comparison as a table of text."""
    from rfpipe.report.page import Table
    from rfpipe.report.text import number

    cells = [
        [
            row["scene"], f"{100 * row['error']:g}", row["method"],
            *(number(row[cost]) for cost in ("patterns", "pictures", "seconds")), row["note"],
        ]
        for row in rows.to_dict("records")
    ]  # fmt: skip
    return Table("Methods at equal error", "", list(_HEADINGS.values()), cells, 3)


def _aligned(table: Table) -> str:
    """Align the columns of a table, and omit scene and error where they repeat."""
    lines = [table.columns, *table.rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text, previous = [], ["", ""]
    for line in lines:
        repeated = line[:2] == previous
        previous = line[:2]
        cells = ["", "", *line[2:]] if repeated else line
        is_left = [index in (0, 2, len(cells) - 1) for index in range(len(cells))]
        padded = [
            cell.ljust(width) if aligns_left else cell.rjust(width)
            for cell, width, aligns_left in zip(cells, widths, is_left, strict=True)
        ]
        text.append("  ".join(padded).rstrip())
    return "\n".join(text)
