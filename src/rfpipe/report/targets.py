"""Targets that an acquisition was given and missed, with the reason that its method gave."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rfpipe.config.model import TARGET_MARGIN
from rfpipe.jobs.targets import misses
from rfpipe.report.text import percent


def ending_of(level_rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the reason that a method gave for its end above the target, or ""."""
    return next((row["ended"] for row in reversed(level_rows) if "ended" in row), "")


def missed_targets(
    row: Mapping[str, Any], reason: str, *, by_few_pictures: bool = False
) -> Iterator[str]:
    """Yield a sentence for each target that the error of an acquisition is above, as shown.

    Parameters
    ----------
    row : mapping
        As of `rfpipe.report.glance.result_of`. The error is that against truth or verification
        pictures, or the method's estimate where neither is known.
    reason : str
        Reason that the method gave for its end, or "".
    by_few_pictures : bool
        Whether the error is that of verification pictures: it scatters, and meets a target up to
        `TARGET_MARGIN` times it, as for the run's exit status.
    """
    measured = row.get("mean_error"), row.get("mean_indirect")
    for miss in misses(row, measured, row, TARGET_MARGIN if by_few_pictures else 1.0):
        if percent(miss.error) == percent(miss.accepted):
            continue
        by = "estimated by the method" if miss.is_estimate else f"verified by: {row['verified']}"
        yield (
            f"TARGET MISSED: the mean {miss.quantity} is {percent(miss.error)} %, "
            f"{percent(miss.target)} % was asked for ({by}). "
            f"{_explained(miss.estimate, miss.target, reason)}"
        )


def _explained(estimated: float | None, limit: float, reason: str) -> str:
    """Return what the method stated about its end."""
    if estimated is None:
        return f"The method ended there: {reason}." if reason else "The method gave no estimate."
    stated = f"The method estimated {percent(estimated)} %"
    if reason:
        return f"{stated} and ended there: {reason}."
    if estimated <= limit:
        return f"{stated}, and so took it for reached."
    return f"{stated}; its log says why it ended."
