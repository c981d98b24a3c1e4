"""``rfpipe run``: acquisitions by Snakemake, with rfpipe's own checks and messages."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from argparse import ArgumentParser
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from rfpipe.cli.arguments import working_in

if TYPE_CHECKING:
    from rfpipe.config import Config

PASSED_ON = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": ["--help", "-h"],
}
"""Settings of the command `run`, which passes unknown options on to Snakemake."""

_REPORT = Path("results") / "report" / "index.html"

_INSPECTIONS = (
    "-n", "--dry-run", "--dryrun", "--unlock", "--lint", "--list", "-l", "--list-rules",
    "--list-target-rules", "--list-changes", "--list-input-changes", "--list-untracked",
    "--summary", "-S", "--detailed-summary", "-D", "--dag", "--rulegraph", "--filegraph", "--d3dag",
    "--archive", "--cleanup-metadata", "--version", "-v",
)  # fmt: skip
"""Options with which Snakemake runs no job."""


def run(context: typer.Context) -> None:
    """Acquire all scenes of a settings file, and print the path of the report.

    The command checks the settings first. It keeps complete results, and continues a run that was
    stopped or killed. Common options:

      --configfile FILE    settings of the run; by default, rfpipe's example
      --directory FOLDER   folder of the run, for its results
      --cores N            number of processor cores; by default, all
      --dry-run            list the jobs without running them
      --keep-going         if a scene fails, continue with the next ones
      --retake SCENE/METHOD/LEVEL
                           capture the pictures of a level again, or of all levels
                           of SCENE/METHOD; the previous ones are set aside
      --put-back SCENE/METHOD/LEVEL
                           undo the last --retake: use the previous pictures again
      --forcerun STAGE     repeat a stage, such as report
      --unlock             remove the lock of another Snakemake on the folder
      --help-all           list all options of Snakemake, which can be used, too

    Exit status 1 if a job failed, or if the error in the verification pictures of a real rig
    exceeds the target error. A Snakefile in the current folder, or --snakefile, replaces rfpipe's.
    """
    from rfpipe.cli.targets import check_executor, check_forced_rules, check_no_settings_file
    from rfpipe.storage.run_record import program

    options = _Options.of(context.args)
    if options.help_all:
        raise typer.Exit(subprocess.call([program("snakemake"), "--help"]))
    check_executor(options.passed_on)
    settings = _checked(options)
    if not options.has_own_snakefile:
        check_no_settings_file(options.without_files)
        is_known = settings is not None and "--config" not in options.passed_on
        jobs = settings.jobs if settings is not None and is_known else None
        check_forced_rules(options.passed_on, _rfpipe_snakefile().parent / "workflow/rules", jobs)
    if not options.inspects or "--unlock" in options.passed_on:
        _unlock_after_kill(options)
    if options.retake and _retake(options, settings):
        return
    if options.put_back and _put_back(options, settings):
        return
    _warn_unrecorded(options)
    snakefile = [] if options.has_own_snakefile else ["--snakefile", str(_rfpipe_snakefile())]
    status = _status_of([program("snakemake"), *snakefile, *options.passed_on])
    if not options.inspects:
        _print_outcome(options.folder, status)
    if status:
        raise typer.Exit(status if status > 0 else 1)


@dataclass(frozen=True)
class _Options:
    """Options of `run`.

    Attributes
    ----------
    files : list of str
        Settings files.
    folder : Path
        Folder of the run.
    has_own_snakefile : bool
        The user's Snakefile replaces rfpipe's.
    help_all : bool
        Print Snakemake's help.
    inspects : bool
        An option makes Snakemake run no job.
    retake, put_back : list of str
        Levels or acquisitions whose pictures are captured again or put back.
    passed_on : list of str
        Arguments for Snakemake.
    without_files : list of str
        Those of `passed_on` except settings files, folder and Snakefile.
    """

    files: list[str]
    folder: Path
    has_own_snakefile: bool
    help_all: bool
    inspects: bool
    retake: list[str]
    put_back: list[str]
    passed_on: list[str]
    without_files: list[str]

    @classmethod
    def of(cls, arguments: list[str]) -> _Options:
        rfpipe_only = ArgumentParser(add_help=False, allow_abbrev=False)
        rfpipe_only.add_argument("--retake", nargs="+", action="extend", default=[])
        rfpipe_only.add_argument("--put-back", nargs="+", action="extend", default=[])
        rfpipe_only.add_argument("--help-all", action="store_true")
        options, passed_on = rfpipe_only.parse_known_args(arguments)
        shared = ArgumentParser(add_help=False, allow_abbrev=False)
        shared.add_argument("--configfile", "--configfiles", nargs="+", action="extend", default=[])
        shared.add_argument("--directory", "-d", type=Path, default=Path())
        shared.add_argument("--snakefile", "-s")
        files, without_files = shared.parse_known_args(passed_on)
        return cls(
            files=files.configfile,
            folder=files.directory,
            has_own_snakefile=bool(files.snakefile) or Path("Snakefile").is_file(),
            help_all=options.help_all,
            inspects=any(option.partition("=")[0] in _INSPECTIONS for option in passed_on),
            retake=options.retake,
            put_back=options.put_back,
            passed_on=passed_on,
            without_files=without_files,
        )


def _rfpipe_snakefile() -> Path:
    from rfpipe.installation import workflow_folder

    return workflow_folder() / "Snakefile"


def _checked(options: _Options) -> Config | None:
    """Check folders, settings and priors; return the settings if they are in a single file."""
    from rfpipe.config import load_config, read_yaml
    from rfpipe.jobs.snakemake import check_no_braces
    from rfpipe.stages.settings import check_priors

    check_no_braces("the run's folder", options.folder.absolute())
    if not options.has_own_snakefile:
        check_no_braces("rfpipe's own folder", _rfpipe_snakefile().parent)
    for file in options.files:
        read_yaml(file)
    if len(options.files) != 1:
        return None
    with working_in(options.folder, Path(options.files[0])) as path:
        settings = load_config(path)
        check_priors(settings, Path("results"))
        return settings


def _unlock_after_kill(options: _Options) -> None:
    """Unlock the folder if its last run was killed; LockedError if a run is working in it."""
    from rfpipe.jobs.snakemake_lock import free_if_dead

    unlocks = "--unlock" in options.passed_on
    command = shlex.join(["rfpipe", "run", *options.passed_on, "--unlock"])
    if free_if_dead(options.folder, None if unlocks else command) and not unlocks:
        typer.echo("rfpipe: continuing the last run in this folder, which was killed", err=True)


def _retake(options: _Options, settings: Config | None) -> bool:
    """Set aside the pictures to capture again; return True if only inspected (--dry-run)."""
    from rfpipe.errors import InputError
    from rfpipe.stages.rig_sources import check_retakes
    from rfpipe.storage.retake import find_retakes

    acquisitions = None if settings is None else settings.acquisitions
    if settings is not None and settings.capture.rig == "offline":
        raise InputError(
            "--retake: the pictures of an offline rig are taken by hand. Undo their import with "
            "'rfpipe import FOLDER --take-back', where FOLDER is the folder of the sheet"
        )
    retakes = find_retakes(options.folder / "results", options.retake, acquisitions)
    if settings is not None and not options.inspects:
        with chdir(options.folder):  # the path of a token file is relative to it
            check_retakes(settings, retakes)
    for retake in retakes:
        if options.inspects:
            typer.echo(f"{retake.path}: its pictures would be captured again")
            continue
        names = ", ".join(path.name for path in retake.set_aside())
        typer.echo(
            f"{retake.path}: its pictures are captured again; the previous ones stay next to the "
            f"new ones, as {names}. Remove them to free space, or use them again by --put-back "
            f"{'/'.join(retake.path.parts[-3:])}"
        )
    return options.inspects


def _put_back(options: _Options, settings: Config | None) -> bool:
    """Put back pictures that were set aside; return True if only inspected (--dry-run)."""
    from rfpipe.storage.retake import find_retakes

    acquisitions = None if settings is None else settings.acquisitions
    results = options.folder / "results"
    levels = find_retakes(results, options.put_back, acquisitions, "--put-back")
    for retake in [level for level in levels if level.is_set_aside] or levels:
        if options.inspects:
            typer.echo(f"{retake.path}: the previous pictures would be put back")
            continue
        names = ", ".join(path.name for path in retake.put_back())
        typer.echo(f"{retake.path}: the previous pictures are put back, as {names}")
    return options.inspects


def _warn_unrecorded(options: _Options) -> None:
    """Warn if results were copied without Snakemake's records of their settings."""
    from rfpipe.jobs.snakemake_lock import unrecorded

    names = [] if {"--forceall", "-F"} & set(options.passed_on) else unrecorded(options.folder)
    if names:
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        typer.echo(
            f"rfpipe: warning: {options.folder / '.snakemake'} has no records of the settings of "
            f"{names[0]}{more}, so changed settings go unnoticed and these results stay as they "
            "are. Copy .snakemake together with results, or run with --forceall: this compares all "
            "stages with the settings, and captures pictures again only where settings changed",
            err=True,
        )


def _print_outcome(folder: Path, status: int) -> None:
    """Print the report's path, the failures, and the acquisitions above their target error."""
    from rfpipe.config.model import TARGET_MARGIN
    from rfpipe.jobs.outcome import failure_line, missed_targets, read_failures
    from rfpipe.storage.run_record import recorded_acquisitions

    results = folder / "results"
    if (folder / _REPORT).is_file() and not status:
        typer.echo(f"report: {os.path.normpath(folder / _REPORT)}")
    missed = missed_targets(results, recorded_acquisitions(results), TARGET_MARGIN)
    failures = [
        failure
        for failure in (read_failures(results) if status else [])
        if not (missed and failure.stage == "bound")
    ]
    if missed:
        typer.echo(f"rfpipe: missed the target error: {'; '.join(map(str, missed))}", err=True)
    if failures:
        typer.echo(f"rfpipe: {failure_line(failures, folder)}", err=True)


def _status_of(command: list[str]) -> int:
    """Run a program and return its exit status, without ending before it on a signal.

    The terminal sends Ctrl-C to the program as well; SIGTERM is passed on. Snakemake then ends its
    jobs.
    """
    process = subprocess.Popen(command)
    # handlers aren't inherited by the program, unlike ignored signals
    previous = {
        signal.SIGINT: signal.signal(signal.SIGINT, lambda *_: None),
        signal.SIGTERM: signal.signal(signal.SIGTERM, lambda *_: process.terminate()),
    }
    try:
        return process.wait()
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
