"""Numbers with their nouns, and fractions in per cent."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 picture`` or ``1,200 pictures``."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def percent(fraction: float) -> str:
    """Return a fraction in per cent: two decimals, or two significant digits below 0.1 %."""
    value = 100 * fraction
    return f"{value:.2g}" if 0 < abs(value) < 0.1 else f"{value:.2f}"
