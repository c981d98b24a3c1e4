"""The forecast of a run as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpipe.stages.capturing.forecast import Forecast

__all__ = ["table"]


def table(forecasts: Sequence[Forecast], free: int) -> str:
    """Return a run's acquisitions, their sum, and what to make of it.

    Parameters
    ----------
    forecasts : sequence of Forecast
    free : int
        Bytes free where the results are to lie.
    """
    import pandas as pd

    from rfpipe.stages.capturing.disk import shown_bytes

    rows = [
        {
            "scene": one.scene,
            "method": one.method,
            "rays": f"{one.rays:,}",
            "levels": one.levels,
            "patterns": f"{one.expected.patterns:,}",
            "time": _duration(one.expected.seconds),
            "disk": shown_bytes(one.expected.disk.total),
            "at most": f"{one.most.patterns:,}",
            "in": _duration(one.most.seconds),
            "with": shown_bytes(one.most.disk.total),
        }
        for one in forecasts
    ]
    seconds = sum(one.expected.seconds for one in forecasts)
    disk = sum(one.expected.disk.total for one in forecasts)
    lines = [pd.DataFrame(rows).to_string(index=False), ""]
    sums = (
        f"One after the other: {_duration(seconds)} of capture, {shown_bytes(disk)} of disk before "
        f"compression; {shown_bytes(free)} are free."
    )
    lines = [pd.DataFrame(rows).to_string(index=False), "", sums]
    if disk > free:
        lines.append(
            "That may not fit: make room, put the results on another disk, or set "
            "capture.keep_raw to false. A level that doesn't fit is refused before its capture."
        )
    return "\n".join(lines)


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    days, hours = divmod(minutes // 60, 24)
    if days:
        return f"{days} d {hours} h"
    return f"{hours} h {minutes % 60:02d} min" if hours else f"{minutes} min"
