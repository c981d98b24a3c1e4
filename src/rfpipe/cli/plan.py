"""``rfpipe plan``: the forecast of a run as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.run import Directory, working_in

if TYPE_CHECKING:
    import pandas as pd

_SHOWN = 30


def plan(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A YAML file of settings.")],
    folder: Annotated[
        Path,
        typer.Option(
            help="Where the results are to lie, seen from the run's folder, for the disk's free "
            "space."
        ),
    ] = Path("results"),
    directory: Directory = Path(),
) -> None:
    """Check a settings file and tell what its run will take: patterns, time, memory and disk.

    Every mistake in the file is said. A rig's settings are checked alone.

    Patterns are the method's guess, on the high side: as many a level as the thesis' largest scenes
    took, or all rounds of methods that end by their own estimate. At most are those of a scene
    without any structure. Time is that of the capture on a rig; disk is before compression.
    """
    from rfpipe.config import load_config, load_rig_config, read_yaml
    from rfpipe.config.files import is_rig
    from rfpipe.stages.forecast import forecast, shown_bytes
    from rfpipe.stages.jobs import workers
    from rfpipe.store import files

    with working_in(directory, config) as path:
        if is_rig(read_yaml(path)):
            rig = load_rig_config(path)
            what = "a bench in software" if rig.bench is not None else f"a rig, {rig.kind}"
            typer.echo(f"{config}: valid. The settings of {what}, for rfpipe calibrate and serve")
            return
        settings = load_config(path)
        typer.echo(f"{config}: valid. {len(settings.acquisitions)} acquisitions\n")
        rows = forecast(settings)
        free = files.free_bytes(folder)
    typer.echo(_shown(rows.head(_SHOWN)).to_string(index=False))
    if len(rows) > _SHOWN:
        typer.echo(f"... and {len(rows) - _SHOWN} more, which the sums take in.")
    disk, memory = int(rows["disk"].sum()), int(rows["memory"].max())
    typer.echo(
        f"\nOne after the other: {_duration(rows['seconds'].sum())} of capture on a rig, "
        f"{shown_bytes(disk)} of disk; {shown_bytes(free)} are free."
    )
    if disk > free:
        typer.echo(
            "That may not fit: make room, put the results on another disk, or set "
            "capture.keep_raw to false. A level that doesn't fit is refused before its capture."
        )
    have = workers.machine_memory_mb() * 10**6
    if memory > have:
        largest = rows.iloc[int(rows["memory"].argmax())]
        typer.echo(
            f"{largest['scene']} by {largest['method']} is likely to take {shown_bytes(memory)} of "
            f"memory, and this machine has {shown_bytes(have)}: acquire it on another one, with "
            "fewer rays, or by another method."
        )


def _shown(rows: pd.DataFrame) -> pd.DataFrame:
    from rfpipe.stages.forecast import shown_bytes

    shown = rows[["scene", "method"]].copy()
    for name, column in (("rays", "rays"), ("levels", "levels"), ("patterns", "patterns")):
        shown[name] = [f"{value:,}" for value in rows[column]]
    shown["on a rig"] = [_duration(value) for value in rows["seconds"]]
    for name in ("disk", "memory"):
        shown[name] = [shown_bytes(value) for value in rows[name]]
    shown["at most"] = [f"{value:,}" for value in rows["most"]]
    shown["in"] = [_duration(value) for value in rows["most_seconds"]]
    return shown


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    days, hours = divmod(minutes // 60, 24)
    if days:
        return f"{days} d {hours} h"
    return f"{hours} h {minutes % 60:02d} min" if hours else f"{minutes} min"
