"""What a rig's devices counted during a capture: failed and lost frames, and attempts anew."""

from __future__ import annotations

from rfpipe.rigs import Rig

__all__ = ["counted_by", "difference"]


def counted_by(rig: Rig) -> dict[str, int]:
    """Return what a rig's devices counted so far, by device and what; nothing of one without."""
    counts: dict[str, dict[str, int]] = getattr(rig, "statistics", None) or {}
    return {
        f"{device} {what}": count for device, of in counts.items() for what, count in of.items()
    }


def difference(after: dict[str, int], before: dict[str, int]) -> dict[str, int]:
    """Return what was counted between; devices that began anew since count from 0."""
    return {
        name: count - before.get(name, 0) if count >= before.get(name, 0) else count
        for name, count in after.items()
    }
