"""``rfpipe plan``: the forecast of a run."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.arguments import ConfigFile, working_in
from rfpipe.text import counted

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config


def plan(
    config: ConfigFile,
    folder: Annotated[
        Path, typer.Option(help="Folder for the results, relative to the run's folder.")
    ] = Path("results"),
    directory: Annotated[
        Path, typer.Option("--directory", "-d", help="Folder of the run, as for 'rfpipe run'.")
    ] = Path(),
) -> None:
    """Check a settings file, and forecast pictures, time, memory and disk space of its run.

    The command reports all mistakes in the file, and requirements of scenes that this machine
    doesn't meet. The settings file of a rig is checked without a forecast.

    Pictures are all brackets that the rig takes: references, symmetry test, patterns, check and
    verification pictures. Their number depends on the scene more than on anything that is known
    before the first picture. "half take" are the quartiles of the tuning scenes of
    docs/benchmark.md; scenes with glass, mirrors and gloss often take 4 to 11 times the expected
    patterns. With a prior, the numbers are those of an unchanged scene. "at most" counts all rounds
    of the method. The log of a run updates the forecast after each round. Time is that of the
    pictures on a rig; disk space is before compression.
    """
    from rfpipe.config import load_config, load_rig_config, read_yaml
    from rfpipe.config.files import is_rig
    from rfpipe.stages.forecast import forecast
    from rfpipe.stages.settings import check_priors
    from rfpipe.store import files

    with working_in(directory, config) as path:
        if is_rig(read_yaml(path)):
            rig = load_rig_config(path)
            what = "a bench in software" if rig.bench is not None else f"a rig, {rig.kind}"
            typer.echo(f"{config}: valid. The settings of {what}, for rfpipe calibrate and serve")
            return
        settings = load_config(path)
        check_priors(settings, folder)
        count = counted(len(settings.acquisitions), "acquisition")
        jobs, reason = settings.jobs_and_reason
        typer.echo(f"{config}: valid. {count}. One job per {jobs}, {reason}\n")
        rows = forecast(settings)
        free = files.free_bytes(folder)
        scene_lines = _lines_of_scenes(settings)
    typer.echo(_forecast_table(rows))
    _print_totals(rows, free)
    if settings.capture.rig == "offline":
        frames, largest = rows["frames"].sum(), rows["max_frames"].sum()
        typer.echo(f"Taken by hand, these are {frames:,} photographs, at most {largest:,}.")
    for line in [*_lines_of_priors(rows), *scene_lines]:
        typer.echo(line)


def _print_totals(rows: pd.DataFrame, free: int) -> None:
    """Print time and disk space of all acquisitions, and whether this machine has enough."""
    from rfpipe.jobs.workers import machine_memory_mb
    from rfpipe.storage.space import bytes_text

    total = rows[["pictures", "max_pictures", "seconds", "max_seconds", "disk", "max_disk"]].sum()
    disk, memory = int(total["disk"]), int(rows["memory"].max())
    scope = "One after the other: " if len(rows) > 1 else "In total: "
    is_open = (rows["max_pictures"] > rows["pictures"]).any()
    max_time = ""
    if is_open:
        max_time = f", at most {total['max_pictures']:,.0f} and {_duration(total['max_seconds'])}"
    max_disk = f", at most {bytes_text(int(total['max_disk']))}" if is_open else ""
    typer.echo(
        f"\n{scope}{total['pictures']:,.0f} pictures and {_duration(total['seconds'])} on a rig"
        f"{max_time}; {bytes_text(disk)} of disk{max_disk}; {bytes_text(free)} are free."
    )
    if total["max_disk"] > free:
        typer.echo(
            "The disk may be too small: make room, put the results on another disk, or set "
            "capture.keep_raw to false. A level that doesn't fit is not captured."
        )
    available = machine_memory_mb() * 10**6
    if memory > available:
        largest = rows.iloc[int(rows["memory"].argmax())]
        typer.echo(
            f"{largest['scene']} by {largest['method']} probably needs {bytes_text(memory)} of "
            f"memory, but this machine has {bytes_text(available)}: use another machine, fewer "
            "rays, or another method."
        )


def _lines_of_priors(rows: pd.DataFrame) -> list[str]:
    """Return a line on each acquisition that begins with a prior."""
    return [
        f"{row['scene']} by {row['method']}: begins with the prior {row['prior']}; "
        f"{row['pictures']:,} pictures if the scene is unchanged, about "
        f"{row['pictures_without_prior']:,} if the prior doesn't help."
        for row in rows[rows["prior"].notna()].to_dict("records")
    ]


def _lines_of_scenes(settings: Config) -> list[str]:
    """Return lines on the choices, omitted light and missing requirements of each scene."""
    from rfpipe.report.text import setting_text

    lines = []
    for name in dict.fromkeys(scene for scene, _ in settings.acquisitions):
        scene = settings.scenes[name]
        choices = (f"{it.setting} {setting_text(it.value)} ({it.reason})" for it in scene.choices)
        sentences = [f"chosen: {', '.join(choices)}"] if scene.choices else []
        sentences += [*scene.omissions, *(f"can't run here: {it}" for it in scene.obstacles)]
        lines += [f"{name}: {sentence}." for sentence in sentences]
    return lines


def _forecast_table(rows: pd.DataFrame) -> str:
    """Format the forecast as a table."""
    from rfpipe.storage.space import bytes_text

    table = rows.copy()
    for name in (
        "rays",
        "patterns",
        "pictures",
        "lower_pictures",
        "upper_pictures",
        "max_pictures",
    ):
        table[name] = rows[name].map("{:,}".format)
    table["half take"] = table["lower_pictures"] + " to " + table["upper_pictures"]
    table["seconds"] = rows["seconds"].map(_duration)
    for name in ("disk", "memory"):
        table[name] = rows[name].map(bytes_text)
    order = [
        "scene",
        "method",
        "rays",
        "patterns",
        "pictures",
        "half take",
        "max_pictures",
        "seconds",
    ]
    names = {"seconds": "time", "max_pictures": "at most"}
    table = table[[*order, "disk", "memory"]].rename(columns=names)
    return table.to_string(index=False, col_space=8)


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
