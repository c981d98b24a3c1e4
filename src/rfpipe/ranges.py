"""Ranges of consecutive items, for work in batches."""

from __future__ import annotations


def ranges(stop: int, longest: int, start: int = 0) -> list[tuple[int, int]]:
    """Divide the items from `start` to ``stop - 1`` into ranges ``(first, last + 1)``.

    Each range has at most `longest` items, at least 1.
    """
    return [(first, min(first + longest, stop)) for first in range(start, stop, longest)]
