"""Text for messages and pages: counts with nouns, percentages, suggestions of similar names."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 picture`` or ``1,200 pictures``."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def percent(fraction: float) -> str:
    """Return a fraction in per cent: two decimals, or two significant digits below 0.1 %."""
    value = 100 * fraction
    return f"{value:.2g}" if 0 < abs(value) < 0.1 else f"{value:.2f}"


def similar_names(
    name: str, names: Iterable[str], *, count: int = 1, cutoff: float = 0.6
) -> list[str]:
    """Return the names most similar to a misspelt one, the most similar first.

    `cutoff` is the least similarity, from 0 to 1 (`difflib.get_close_matches`).
    """
    return get_close_matches(name, list(names), n=count, cutoff=cutoff)


def did_you_mean(name: str, names: Iterable[str], *, cutoff: float = 0.6) -> str:
    """Return ``did you mean wedge?`` for the most similar name; empty if none is similar."""
    similar = similar_names(name, names, cutoff=cutoff)
    return f"did you mean {similar[0]}?" if similar else ""
