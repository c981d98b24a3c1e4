"""``rfpipe run``, ``plan`` and ``catalogue``: a run, before it begins, and what became of it."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from argparse import ArgumentParser
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.text import counted

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config

ConfigFile = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="A YAML file of a run's settings.")
]
PASSED_ON = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": ["--help", "-h"],
}
"""How `run` is registered: what isn't ours of all that follows its name is for Snakemake."""

_REPORT = Path("results") / "report" / "index.html"

_LOOKS = (
    "-n", "--dry-run", "--dryrun", "--unlock", "--lint", "--list", "-l", "--list-rules",
    "--list-target-rules", "--list-changes", "--list-input-changes", "--list-untracked",
    "--summary", "-S", "--detailed-summary", "-D", "--dag", "--rulegraph", "--filegraph", "--d3dag",
    "--archive", "--cleanup-metadata", "--version", "-v",
)  # fmt: skip
"""Options of Snakemake with which it runs no job."""


def run(context: typer.Context) -> None:
    """Run the workflow in this folder, and print the report's path.

    The settings of --configfile, or of rfpipe's default run, are checked first. Complete results
    stay; a run that was stopped or killed continues. Common options:

      --configfile FILE    the settings of the run
      --directory FOLDER   the run's folder, where its results lie
      --cores N            processor cores to use; all of them by default
      --dry-run            list the jobs that would run
      --keep-going         go on with the other scenes where one fails
      --retake SCENE/METHOD/LEVEL
                           take a level's pictures again, or all of SCENE/METHOD;
                           the old ones are set aside, once the rig has answered
      --put-back SCENE/METHOD/LEVEL
                           take the pictures that were set aside last in place of
                           those that were taken since
      --forcerun STAGE     run a stage again, such as report
      --unlock             free a folder that an unknown Snakemake has locked
      --help-all           all options, which are Snakemake's

    Exit status 1 where a job failed, or a real rig's pictures are further from the transport than
    the target error allows. A Snakefile in this folder, or --snakefile, takes the place of
    rfpipe's own.
    """
    from rfpipe.cli.targets import check_forced_rules, check_no_settings_file
    from rfpipe.storage.run_record import program

    options = _Options.of(context.args)
    if options.help_all:
        raise typer.Exit(subprocess.call([program("snakemake"), "--help"]))
    settings = _checked(options)
    if not options.is_named:
        check_no_settings_file(options.rest)
        is_whole = settings is not None and "--config" not in options.passed_on
        jobs = settings.jobs if settings is not None and is_whole else None
        check_forced_rules(options.passed_on, _own_snakefile().parent / "workflow/rules", jobs)
    if not options.looks or "--unlock" in options.passed_on:
        _free(options)
    if options.retake and _retaken(options, settings):
        return
    if options.put_back and _put_back(options, settings):
        return
    _warn_unrecorded(options)
    own = [] if options.is_named else ["--snakefile", str(_own_snakefile())]
    ended = _to_its_end([program("snakemake"), *own, *options.passed_on])
    if not options.looks:
        _say_outcome(options.folder, ended)
    if ended:
        raise typer.Exit(ended if ended > 0 else 1)


@dataclass(frozen=True)
class _Options:
    """The options of `run`: ours, and those that are passed on to Snakemake."""

    files: list[str]
    folder: Path
    is_named: bool
    help_all: bool
    looks: bool
    retake: list[str]
    put_back: list[str]
    passed_on: list[str]
    rest: list[str]
    """Those that are passed on without settings files and folders."""

    @classmethod
    def of(cls, arguments: list[str]) -> _Options:
        ours = ArgumentParser(add_help=False, allow_abbrev=False)
        ours.add_argument("--retake", nargs="+", action="extend", default=[])
        ours.add_argument("--put-back", nargs="+", action="extend", default=[])
        ours.add_argument("--help-all", action="store_true")
        own, passed_on = ours.parse_known_args(arguments)
        shared = ArgumentParser(add_help=False, allow_abbrev=False)
        shared.add_argument("--configfile", "--configfiles", nargs="+", action="extend", default=[])
        shared.add_argument("--directory", "-d", type=Path, default=Path())
        shared.add_argument("--snakefile", "-s")
        known, rest = shared.parse_known_args(passed_on)
        return cls(
            files=known.configfile,
            folder=known.directory,
            is_named=bool(known.snakefile) or Path("Snakefile").is_file(),
            help_all=own.help_all,
            looks=any(option.partition("=")[0] in _LOOKS for option in passed_on),
            retake=own.retake,
            put_back=own.put_back,
            passed_on=passed_on,
            rest=rest,
        )


def _own_snakefile() -> Path:
    from rfpipe.provenance import workflow_folder

    return workflow_folder() / "Snakefile"


def _checked(options: _Options) -> Config | None:
    """Check folders and settings; return these where they are of one file."""
    from rfpipe.config import load_config, read_yaml
    from rfpipe.jobs.snakemake import check_no_braces

    check_no_braces("the run's folder", options.folder.absolute())
    if not options.is_named:
        check_no_braces("rfpipe's own folder", _own_snakefile().parent)
    for file in options.files:
        read_yaml(file)
    if len(options.files) != 1:
        return None
    with _working_in(options.folder, Path(options.files[0])) as path:
        return load_config(path)


def _free(options: _Options) -> None:
    """Free the folder where its last run was killed; raise LockedError where a run works in it."""
    from rfpipe.jobs.snakemake_lock import free_if_dead

    unlocks = "--unlock" in options.passed_on
    command = shlex.join(["rfpipe", "run", *options.passed_on, "--unlock"])
    if free_if_dead(options.folder, None if unlocks else command) and not unlocks:
        typer.echo("rfpipe: the last run in this folder was killed; going on from there", err=True)


def _retaken(options: _Options, settings: Config | None) -> bool:
    """Set aside the pictures to take again; return True for a rehearsal, with --dry-run."""
    from rfpipe.errors import InputError
    from rfpipe.stages.rig_sources import check_retakes
    from rfpipe.storage.retake import find_retakes

    acquisitions = None if settings is None else settings.acquisitions
    if settings is not None and settings.capture.rig == "offline":
        raise InputError(
            "--retake: these pictures are taken by hand (capture.rig is offline). Take them back "
            "with 'rfpipe import FOLDER --take-back', FOLDER being the sheet's"
        )
    retakes = find_retakes(options.folder / "results", options.retake, acquisitions)
    if settings is not None and not options.looks:
        with chdir(options.folder):  # where a token's file is looked for
            check_retakes(settings, retakes)
    for retake in retakes:
        if options.looks:
            typer.echo(f"{retake.path}: its pictures would be taken again")
            continue
        kept = ", ".join(path.name for path in retake.set_aside())
        typer.echo(
            f"{retake.path}: its pictures are taken again; the old ones are kept beside the new "
            f"ones, as {kept}. Remove them to free the space, or put them back with --put-back "
            f"{'/'.join(retake.path.parts[-3:])} in place of --retake"
        )
    return options.looks


def _put_back(options: _Options, settings: Config | None) -> bool:
    """Put pictures back that were set aside; return True for a rehearsal, with --dry-run."""
    from rfpipe.storage.retake import find_retakes

    acquisitions = None if settings is None else settings.acquisitions
    results = options.folder / "results"
    levels = find_retakes(results, options.put_back, acquisitions, "--put-back")
    for retake in [level for level in levels if level.is_set_aside] or levels:
        if options.looks:
            typer.echo(f"{retake.path}: the pictures set aside last would be put back")
            continue
        names = ", ".join(path.name for path in retake.put_back())
        typer.echo(f"{retake.path}: the pictures set aside last are put back, as {names}")
    return options.looks


def _warn_unrecorded(options: _Options) -> None:
    """Warn of results that were copied without Snakemake's records of their settings."""
    from rfpipe.jobs.snakemake_lock import unrecorded

    names = [] if {"--forceall", "-F"} & set(options.passed_on) else unrecorded(options.folder)
    if names:
        several = f" and {len(names) - 1} more" if len(names) > 1 else ""
        typer.echo(
            f"rfpipe: warning: {options.folder / '.snakemake'} has no records of the settings of "
            f"{names[0]}{several}: settings that changed since can't be noticed, and these results "
            "stay as they are. Copy .snakemake with results, or run with --forceall: it compares "
            "all stages with the settings, and takes pictures again only where these changed",
            err=True,
        )


def _say_outcome(folder: Path, ended: int) -> None:
    """Print the report's path, the failures, and the acquisitions above their target error."""
    from rfpipe.config.model import TARGET_MARGIN
    from rfpipe.jobs.outcome import failure_line, missed_targets, read_failures
    from rfpipe.storage.run_record import recorded_acquisitions

    results = folder / "results"
    if (folder / _REPORT).is_file() and not ended:
        typer.echo(f"report: {os.path.normpath(folder / _REPORT)}")
    missed = missed_targets(results, recorded_acquisitions(results), TARGET_MARGIN)
    failures = [
        failure
        for failure in (read_failures(results) if ended else [])
        if not (missed and failure.stage == "bound")
    ]
    if missed:
        typer.echo(f"rfpipe: missed the target error: {'; '.join(map(str, missed))}", err=True)
    if failures:
        typer.echo(f"rfpipe: {failure_line(failures, folder)}", err=True)


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

    Patterns of auto, near_far and footprints follow from target_error: half of the scenes of
    docs/benchmark.md took 0.75 to 1.75 times as many, scenes with glass and mirrors 4 to 20 times;
    "at most" are all rounds that the method knows. Of symmetric and dual they are on the high side:
    as many a level as the thesis' largest scenes took. Time is for the capture on a rig; disk
    is before compression.
    """
    from rfpipe.config import load_config, load_rig_config, read_yaml
    from rfpipe.config.files import is_rig
    from rfpipe.stages.forecast import forecast
    from rfpipe.store import files

    with _working_in(directory, config) as path:
        if is_rig(read_yaml(path)):
            rig = load_rig_config(path)
            what = "a bench in software" if rig.bench is not None else f"a rig, {rig.kind}"
            typer.echo(f"{config}: valid. The settings of {what}, for rfpipe calibrate and serve")
            return
        settings = load_config(path)
        count = counted(len(settings.acquisitions), "acquisition")
        jobs, why = settings.jobs_and_reason
        typer.echo(f"{config}: valid. {count}. One job a{'n' * (jobs[0] == 'a')} {jobs}, {why}\n")
        rows = forecast(settings)
        free = files.free_bytes(folder)
        of_scenes = _lines_of_scenes(settings)
    typer.echo(_shown(rows))
    _say_totals(rows, free)
    for line in of_scenes:
        typer.echo(line)


def _say_totals(rows: pd.DataFrame, free: int) -> None:
    """Print what all acquisitions take together, and what this machine lacks for them."""
    from rfpipe.jobs.workers import machine_memory_mb
    from rfpipe.storage.space import bytes_text

    total = rows[["seconds", "max_seconds", "disk", "max_disk"]].sum()
    disk, memory = int(total["disk"]), int(rows["memory"].max())
    together = "One after the other: " if len(rows) > 1 else "In all: "
    is_open = (rows["max_patterns"] > rows["patterns"]).any()
    most = f", at most {_duration(total['max_seconds'])}" if is_open else ""
    most_disk = f", at most {bytes_text(int(total['max_disk']))}" if is_open else ""
    typer.echo(
        f"\n{together}{_duration(total['seconds'])} of capture on a rig{most}; "
        f"{bytes_text(disk)} of disk{most_disk}; {bytes_text(free)} are free."
    )
    if total["max_disk"] > free:
        typer.echo(
            "That may not fit: make room, put the results on another disk, or set "
            "capture.keep_raw to false. A level that doesn't fit is refused before its capture."
        )
    have = machine_memory_mb() * 10**6
    if memory > have:
        largest = rows.iloc[int(rows["memory"].argmax())]
        typer.echo(
            f"{largest['scene']} by {largest['method']} is likely to take {bytes_text(memory)} of "
            f"memory, and this machine has {bytes_text(have)}: acquire it on another one, with "
            "fewer rays, or by another method."
        )


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
    from rfpipe.storage.space import bytes_text

    table = rows.drop(columns=["max_seconds", "max_disk"])
    for name in ("rays", "patterns", "max_patterns"):
        table[name] = rows[name].map("{:,}".format)
    table["seconds"] = rows["seconds"].map(_duration)
    for name in ("disk", "memory"):
        table[name] = rows[name].map(bytes_text)
    order = ["scene", "method", "rays", "patterns", "max_patterns", "seconds"]
    names = {"seconds": "time", "max_patterns": "at most"}
    table = table[[*order, "disk", "memory"]].rename(columns=names)
    return table.to_string(index=False, col_space=8)


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
