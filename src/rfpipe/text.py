"""Numbers with their nouns."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 picture`` or ``1,200 pictures``."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"
