"""The table of acquisitions: a row each, appended as it is done."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.methods.cases import Case

from rfpipe.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CASE", "COLUMNS", "appending", "known_keys", "newest"]

CASE = tuple(field.name for field in fields(Case))
COLUMNS = (
    "key", *CASE, "what", "held_out_scene", "held_out_seed", "status", "why", "camera_rays",
    "projector_rays", "patterns", "brackets", "exposure_s", "light_s", "error_mean", "error_worst",
    "worst_picture", "unlit_mean", "unlit_worst", "photo_mean", "photo_unlit", "grain",
    "estimated_error", "patterns_by_estimate", "processing_s", "stored_mb", "date", "machine",
    "code",
)  # fmt: skip
"""Columns of the table, see `benchmarks.methods.page`."""


def known_keys(path: Path) -> set[str]:
    """Return the keys of the rows that are there.

    Raises
    ------
    InputError
        When the table has other columns.
    """
    if not path.exists() or not path.stat().st_size:
        return set()
    with path.open(newline="") as file:
        found = csv.DictReader(file)
        if found.fieldnames != list(COLUMNS):
            raise InputError(f"{path}: expected the columns {', '.join(COLUMNS)}; move it away")
        return {row["key"] for row in found}


@contextmanager
def appending(path: Path) -> Iterator[Any]:
    """Open the table; yields what appends a row, which is on disk when it returns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
        if file.tell() == 0:
            writer.writeheader()

        def append(row: Mapping[str, object]) -> None:
            writer.writerow(
                {name: f"{x:.5g}" if isinstance(x, float) else x for name, x in row.items()}
            )
            file.flush()

        yield append


def newest(path: Path) -> pd.DataFrame:
    """Return the newest row of each case, in the order in which they were run."""
    import pandas as pd

    texts = ["option", "status", "why", "worst_picture"]
    table = pd.read_csv(
        path, keep_default_na=False, na_values=["", "nan"], dtype=dict.fromkeys(texts, str)
    )
    table[texts] = table[texts].fillna("")
    return table.drop_duplicates(list(CASE), keep="last").reset_index(drop=True)
