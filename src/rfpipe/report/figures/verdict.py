"""Verdicts on the thesis' claims, and the limits that they all share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["FAIR", "GOOD", "HOLDS", "NOT", "PART", "Verdict", "by_error", "worst"]

HOLDS, PART, NOT = "holds", "in part", "does not"

GOOD, FAIR = 0.05, 0.2
"""Errors, as fractions, up to which a claim holds, and holds in part."""


@dataclass(frozen=True)
class Verdict:
    """Whether a claim holds.

    Attributes
    ----------
    figure : str
        The thesis' figure or table.
    verdict : str
        "holds", "in part" or "does not".
    numbers : str
        What says so.
    """

    figure: str
    verdict: str
    numbers: str


def by_error(error: float) -> str:
    """Judge by an error, as a fraction; NaN is none."""
    return HOLDS if error <= GOOD else PART if error <= FAIR else NOT


def worst(found: Iterable[str]) -> str:
    """Return the worst of some verdicts: a claim of several parts holds where all do."""
    return max(found, key=(HOLDS, PART, NOT).index)
