"""What an acquisition said of its own error, level by level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["HISTORY_COLUMNS", "estimates", "history"]

HISTORY_COLUMNS = ("level", "patterns", "estimated_error")
"""Level; patterns shown up to there, the floodlit one included; the error that the method then
estimated, relative to the norm of a relit image."""


def estimates(level_rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return `HISTORY_COLUMNS` of the levels after which the method estimated its error.

    Parameters
    ----------
    level_rows : iterable of dict
        As `rfpipe.transport.Transport.level_rows`; a level without an estimate has no
        ``estimated_error``.
    """
    found, shown = [], 0
    for row in level_rows:
        shown += int(row["patterns"])
        if "estimated_error" in row:
            error = float(row["estimated_error"])
            found.append({"level": int(row["level"]), "patterns": shown, "estimated_error": error})
    return found


def history(level_rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return `estimates` as a table: int64, int64 and float64, empty where there is none."""
    import pandas as pd

    table = pd.DataFrame(estimates(level_rows), columns=list(HISTORY_COLUMNS))
    return table.astype({"level": "int64", "patterns": "int64", "estimated_error": "float64"})
