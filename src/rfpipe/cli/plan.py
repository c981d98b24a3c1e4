"""``rfpipe plan``: the forecast of a run as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.run import Directory, working_in

if TYPE_CHECKING:
    from rfpipe.stages.capturing.forecast import Forecast

__all__ = ["plan", "table"]

_SHOWN = 30
_FROM = {"taken": "as taken", "alike": "as others", "guess": "a guess"}


def plan(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A YAML file of settings.")],
    folder: Annotated[
        Path,
        typer.Option(
            help="Where the results are to lie, seen from the run's folder, for the disk's free "
            "space; acquisitions that are there are learnt from."
        ),
    ] = Path("results"),
    directory: Directory = Path(),
) -> None:
    """Tell what a run will take, before the lamp is switched on: patterns, time, memory and disk.

    Expected are the counts of the same acquisitions in the results' folder ("as taken"); else a
    guess, in the proportion in which others by the same method came out ("as others"). The guess
    alone is on the high side: as many patterns a level as the thesis' largest scenes took, or all
    rounds of methods that end by their own estimate. At most are those of a scene without any
    structure. Memory is that of one acquisition at a time, as jobs on a cluster ask for it with a
    margin.
    """
    from rfpipe.config import load_config
    from rfpipe.costs import JobCosts
    from rfpipe.photometry import sensor_from_config
    from rfpipe.stages.capturing.forecast import forecast
    from rfpipe.stages.capturing.taken import taken_in
    from rfpipe.stages.jobs.workers import machine_memory_mb
    from rfpipe.store.files import free_bytes

    with working_in(directory, config) as path:
        settings = load_config(path)
        found = forecast(settings, sensor_from_config(settings.camera), taken_in(folder))
        simulated = settings.capture.rig == "simulated"
        costs = JobCosts(settings, folder)
        memory = [costs.predict("memory_mb", "acquire", one.scene, one.method) for one in found]
        typer.echo(table(found, free_bytes(folder), simulated=simulated, memory_mb=memory))
    scarce = _scarce(found, memory, machine_memory_mb())
    if scarce:
        typer.echo(scarce)


def table(
    forecasts: Sequence[Forecast],
    free: int,
    *,
    simulated: bool = False,
    memory_mb: Sequence[float | None] = (),
) -> str:
    """Return a run's acquisitions, their sum, and what to make of it.

    Parameters
    ----------
    forecasts : sequence of Forecast
    free : int
        Bytes free where the results are to lie.
    simulated : bool
        Whether the rig is simulated, and doesn't wait for a lamp.
    memory_mb : sequence of float or None
        Memory that each is likely to take, None where that isn't known; nothing to leave it out.
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
            "known": _FROM[one.known] if _is_open(one) else "at most",
            **({"here": "?" if one.here is None else _duration(one.here)} if simulated else {}),
            "on a rig" if simulated else "time": _duration(one.expected.seconds),
            "disk": shown_bytes(one.expected.disk.total),
            "at most": f"{one.most.patterns:,}",
            "in": _duration(one.most.seconds),
            "with": shown_bytes(one.most.disk.total),
        }
        for one in forecasts[: _SHOWN if len(forecasts) > _SHOWN + 1 else None]
    ]
    for row, memory in zip(rows, memory_mb, strict=False):
        row["memory"] = "?" if memory is None else shown_bytes(round(memory * 1e6))
    seconds = sum(one.expected.seconds for one in forecasts)
    disk = sum(one.expected.disk.total for one in forecasts)
    sums = (
        f"One after the other: {_duration(seconds)} of capture{' on a rig' if simulated else ''}, "
        f"{shown_bytes(disk)} of disk before compression; {shown_bytes(free)} are free."
    )
    guessed = sum(one.known == "guess" and _is_open(one) for one in forecasts)
    guesses = (
        f"{guessed:,} of {len(forecasts):,} are guesses on the high side, since none of their size "
        "by their method is done yet: acquire some, then plan anew."
    )
    unseen = len(forecasts) - len(rows)
    rest = [f"... and {unseen} more, which the sums take in."] if unseen else []
    lines = [pd.DataFrame(rows).to_string(index=False), *rest, "", sums]
    if simulated:
        lines.append(_here(forecasts))
    if guessed:
        lines.append(guesses)
    if disk > free:
        lines.append(
            "That may not fit: make room, put the results on another disk, or set "
            "capture.keep_raw to false. A level that doesn't fit is refused before its capture."
        )
    return "\n".join(lines)


def _is_open(one: Forecast) -> bool:
    """Whether fewer patterns than the most are expected, or are known to have sufficed."""
    return one.known != "guess" or one.expected.patterns < one.most.patterns


def _scarce(
    forecasts: Sequence[Forecast], memory_mb: Sequence[float | None], have_mb: int
) -> str | None:
    """Say what this machine's memory may not suffice for; None where it does."""
    from rfpipe.stages.capturing.disk import shown_bytes

    most, what = max(
        (memory or 0.0, f"{one.scene} by {one.method}")
        for one, memory in zip(forecasts, memory_mb, strict=True)
    )
    if most <= have_mb:
        return None
    return (
        f"{what} is likely to take {shown_bytes(round(most * 1e6))} of memory, and this machine "
        f"has {shown_bytes(have_mb * 10**6)}: acquire it on another one, with fewer rays, or by "
        "another method."
    )


def _here(forecasts: Sequence[Forecast]) -> str:
    """Say what the simulation takes, as far as that is known."""
    known = [one.here for one in forecasts if one.here is not None]
    said = "The rig is simulated, and doesn't wait for a lamp"
    if not known:
        return f"{said}: how long that takes here will be known from the first acquisition on."
    unknown = len(forecasts) - len(known)
    more = f", and {unknown} of which nothing is known yet" if unknown else ""
    return f"{said}: here, one after the other, {_duration(sum(known))} with all processing{more}."


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    days, hours = divmod(minutes // 60, 24)
    if days:
        return f"{days} d {hours} h"
    return f"{hours} h {minutes % 60:02d} min" if hours else f"{minutes} min"
