"""Targets that an acquisition was given and missed, with the reason that its method gave."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rfpipe.config.model import TARGET_MARGIN
from rfpipe.report.text import percent

_KINDS = (
    ("mean_error", "target_error", "estimated_error", "the mean error"),
    (
        "mean_indirect",
        "target_indirect",
        "estimated_indirect",
        "the mean error of indirect light",
    ),
)


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
    for name, target, estimate, quantity in _KINDS:
        error, is_estimate = row.get(name), False
        if error is None:
            error, is_estimate = row.get(estimate), True
        limit = row.get(target)
        if error is None or limit is None:
            continue
        accepted = limit * (TARGET_MARGIN if by_few_pictures and not is_estimate else 1)
        if error <= accepted or percent(error) == percent(accepted):
            continue
        by = "estimated by the method" if is_estimate else f"verified by: {row['verified']}"
        yield (
            f"TARGET MISSED: {quantity} is {percent(error)} %, {percent(limit)} % was asked for "
            f"({by}). {_explained(row.get(estimate), limit, reason)}"
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
