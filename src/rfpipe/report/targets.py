"""Sentences on missed targets, with the reason that the method gave for its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rfpipe.config.model import TARGET_MARGIN
from rfpipe.jobs.targets import misses
from rfpipe.report.text import rounded_percent


def ending_of(level_rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the reason that a method gave for ending above its target, or ""."""
    return next((row["ended"] for row in reversed(level_rows) if "ended" in row), "")


def missed_target_texts(
    row: Mapping[str, Any], reason: str, *, by_few_pictures: bool = False
) -> Iterator[str]:
    """Yield a sentence for each missed target of an acquisition.

    A target that the error exceeds by less than the displayed decimals is not reported.

    Parameters
    ----------
    row : mapping
        Row of `rfpipe.report.glance.result_of`: the error against truth or verification pictures,
        or the method's estimate if both are unknown.
    reason : str
        Reason that the method gave for its end, or "".
    by_few_pictures : bool
        Whether the error was measured by verification pictures. It scatters, so that an error up
        to `TARGET_MARGIN` times the target meets it, as for the run's exit status.
    """
    measured = row.get("mean_error"), row.get("mean_indirect")
    for miss in misses(row, measured, row, TARGET_MARGIN if by_few_pictures else 1.0):
        if rounded_percent(miss.error) == rounded_percent(miss.accepted):
            continue
        source = (
            "estimated by the method" if miss.is_estimate else f"verified by: {row['verified']}"
        )
        yield (
            f"TARGET MISSED: the mean {miss.quantity} is {rounded_percent(miss.error)} %, "
            f"its target is {rounded_percent(miss.target)} % ({source}). "
            f"{_explained(miss.estimate, miss.target, reason)}"
        )


def _explained(estimated: float | None, limit: float, reason: str) -> str:
    """Describe the method's estimate, and the reason for its end."""
    if estimated is None:
        return f"The method ended there: {reason}." if reason else "The method gave no estimate."
    stated = f"The method estimated {rounded_percent(estimated)} %"
    if reason:
        return f"{stated} and ended there: {reason}."
    if estimated <= limit:
        return f"{stated}, so it ended."
    return f"{stated}; its log has the reason for its end."
