"""``rfpipe run``, ``plan`` and ``catalogue``: a run, before it begins, and what became of it."""

from __future__ import annotations

import os
import signal
import subprocess
from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config

ConfigFile = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="A YAML file of a run's settings.")
]
PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
"""How `run` is registered: all that follows its name is for Snakemake."""

_REPORT = Path("results") / "report" / "index.html"


def run(context: typer.Context) -> None:
    """Run the workflow in this folder; options are Snakemake's, as --directory and --configfile.

    The settings are checked first, so that what is wrong is said with its file and line. At the
    end the report's path is printed. A Snakefile in this folder, or --snakefile, takes the place of
    rfpipe's own.
    """
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--configfile", "--configfiles", nargs="+", action="extend", default=[])
    parser.add_argument("--directory", "-d", type=Path, default=Path())
    parser.add_argument("--snakefile", "-s")
    arguments, _ = parser.parse_known_args(context.args)
    files, folder = arguments.configfile, arguments.directory
    from rfpipe.config import load_config, read_yaml
    from rfpipe.provenance import workflow_folder
    from rfpipe.stages.jobs.ends import check_no_braces, program

    check_no_braces("the run's folder", folder.absolute())
    for file in files:
        read_yaml(file)
    if len(files) == 1:
        with _working_in(folder, Path(files[0])) as settings:
            load_config(settings)
    is_named = arguments.snakefile or Path("Snakefile").is_file()
    if not is_named:
        check_no_braces("rfpipe's own folder", workflow_folder())
    own = [] if is_named else ["--snakefile", str(workflow_folder() / "Snakefile")]
    ended = _to_its_end([program("snakemake"), *own, *context.args])
    if ended:
        raise typer.Exit(ended if ended > 0 else 1)
    report = folder / _REPORT
    if report.is_file():
        typer.echo(f"report: {os.path.normpath(report)}")


@contextmanager
def _working_in(folder: Path, settings: Path) -> Iterator[Path]:
    """Go to a run's folder, where the files are looked for that its settings name.

    Yields the settings' path as it is from there.
    """
    from_there = settings.absolute() if folder != Path() else settings
    with chdir(folder if folder.is_dir() else Path()):
        yield from_there


def _to_its_end(command: list[str]) -> int:
    """Run a program to its own end and return its status, whatever signals come.

    Ctrl-C reaches it as well, from the terminal; SIGTERM is passed on. It ends its jobs by itself.
    """
    process = subprocess.Popen(command)
    # handlers, which a program that is started doesn't inherit
    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, lambda *_: None),
        signal.SIGTERM: signal.signal(signal.SIGTERM, lambda *_: process.terminate()),
    }
    try:
        return process.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def plan(
    config: ConfigFile,
    folder: Annotated[
        Path, typer.Option(help="Where the results are to lie, seen from the run's folder.")
    ] = Path("results"),
    directory: Annotated[
        Path, typer.Option("--directory", "-d", help="The run's folder, as 'rfpipe run' takes it.")
    ] = Path(),
) -> None:
    """Check a settings file and tell what its run will take: patterns, time, memory and disk.

    Every mistake in the file is said, and what a scene needs that this machine lacks. A rig's
    settings are checked alone.

    Patterns are the method's guess, on the high side: as many a level as the thesis' largest scenes
    took. "Up to" are all rounds of a method that ends by its own estimate: for 1 % of error the
    scenes of docs/benchmark.md took 13 to 363 of 657. Time is that of the capture on a rig; disk is
    before compression.
    """
    from rfpipe.config import load_config, load_rig_config, read_yaml
    from rfpipe.config.files import is_rig
    from rfpipe.stages.forecast import forecast, shown_bytes
    from rfpipe.stages.jobs.workers import machine_memory_mb
    from rfpipe.store import files

    with _working_in(directory, config) as path:
        if is_rig(read_yaml(path)):
            rig = load_rig_config(path)
            what = "a bench in software" if rig.bench is not None else f"a rig, {rig.kind}"
            typer.echo(f"{config}: valid. The settings of {what}, for rfpipe calibrate and serve")
            return
        settings = load_config(path)
        typer.echo(f"{config}: valid. {len(settings.acquisitions)} acquisitions\n")
        rows = forecast(settings)
        free = files.free_bytes(folder)
        of_scenes = _lines_of_scenes(settings)
    typer.echo(_shown(rows))
    disk, memory = int(rows["disk"].sum()), int(rows["memory"].max())
    most = "up to " if rows["ends_itself"].any() else ""
    typer.echo(
        f"\nOne after the other: {most}{_duration(rows['seconds'].sum())} of capture on a rig, "
        f"{shown_bytes(disk)} of disk; {shown_bytes(free)} are free."
    )
    if disk > free:
        typer.echo(
            "That may not fit: make room, put the results on another disk, or set "
            "capture.keep_raw to false. A level that doesn't fit is refused before its capture."
        )
    have = machine_memory_mb() * 10**6
    if memory > have:
        largest = rows.iloc[int(rows["memory"].argmax())]
        typer.echo(
            f"{largest['scene']} by {largest['method']} is likely to take {shown_bytes(memory)} of "
            f"memory, and this machine has {shown_bytes(have)}: acquire it on another one, with "
            "fewer rays, or by another method."
        )
    for line in of_scenes:
        typer.echo(line)


def _lines_of_scenes(settings: Config) -> list[str]:
    """Return a line on each choice that scenes make, on light left out and on what is lacking."""
    from rfpipe.report.text import plain

    lines = []
    for name in dict.fromkeys(scene for scene, _ in settings.acquisitions):
        scene = settings.scenes[name]
        choices = (f"{it.setting} {plain(it.value)} ({it.reason})" for it in scene.choices)
        sentences = [f"chosen: {', '.join(choices)}"] if scene.choices else []
        sentences += [*scene.omissions, *(f"can't run here: {it}" for it in scene.obstacles)]
        lines += [f"{name}: {sentence}." for sentence in sentences]
    return lines


def _shown(rows: pd.DataFrame) -> str:
    from rfpipe.stages.forecast import shown_bytes

    table = rows.drop(columns="ends_itself")
    for name in ("rays", "patterns"):
        table[name] = rows[name].map("{:,}".format)
    table["seconds"] = rows["seconds"].map(_duration)
    for name in ("disk", "memory"):
        table[name] = rows[name].map(shown_bytes)
    for name in ("patterns", "seconds"):
        table[name] = table[name].mask(rows["ends_itself"], "up to " + table[name])
    return table.rename(columns={"seconds": "time"}).to_string(index=False, col_space=8)


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def catalogue(
    config: ConfigFile,
    folder: Annotated[
        Path, typer.Option(help="The run's results, finished or not, or while it runs.")
    ] = Path("results"),
) -> None:
    """Write results/catalogue/index.html: what became of each acquisition, with a small picture.

    A run with a collection writes it when it begins and when it ends, however it ends; this command
    writes it at any time. Sort and filter it in any browser.
    """
    from rfpipe.config import load_config
    from rfpipe.report.catalogue import CATALOGUE, write_catalogue

    counts = write_catalogue(load_config(config), folder)
    summary = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    typer.echo(f"{folder / CATALOGUE}: {summary}")
