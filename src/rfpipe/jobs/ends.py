"""Where Snakemake itself runs: how a run was started, and what is said when jobs or a run end."""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from rfpipe.errors import InputError, StoreError
from rfpipe.store import read_manifest, write_manifest

RUN = "run.json"
"""Lies in ``results``: how the run was started."""

_PATIENCE_SECONDS = 60
_SNAKEFILE, _CONFIGFILE = "--snakefile", "--configfile"


def program(name: str) -> str:
    """Return the path of a program that is installed beside this Python, or its name."""
    beside = Path(sys.executable).with_name(name)
    return str(beside) if beside.exists() else shutil.which(name) or name


def check_no_braces(name: str, path: str | Path) -> None:
    """Refuse a path that Snakemake can't have: it takes braces in it for wildcards.

    Of a run's folder, Snakemake then finds no locks or those of other folders. Raises InputError.
    """
    if any(brace in str(path) for brace in "{}"):
        raise InputError(
            f"{name} is {path}; Snakemake takes braces in a path for wildcards. Use a folder "
            "without braces in its name and in those above it"
        )


def write_run(
    results: Path,
    snakefile: Path,
    configfiles: Iterable[Path],
    overrides: dict[str, Any],
    acquisitions: Iterable[tuple[str, str]] = (),
) -> None:
    """Write how a run was started: its files, the settings of the command line, its acquisitions.

    Files in the run's folder have paths relative to it, so that the run can be copied or renamed.
    """
    home = results.resolve().parent
    options = [_SNAKEFILE, _relative_to(home, snakefile)]
    for name, values in (
        (_CONFIGFILE, [_relative_to(home, path) for path in configfiles]),
        ("--config", [f"{name}={value}" for name, value in overrides.items()]),
    ):
        options += [name, *values] if values else []
    named = [list(acquisition) for acquisition in acquisitions]
    write_manifest(results / RUN, {"options": options, "acquisitions": named})


def acquisitions_of(results: Path) -> list[tuple[str, str]]:
    """Return scene and method of each acquisition of a run; none where that isn't known."""
    try:
        named = read_manifest(results / RUN)["acquisitions"]
    except (StoreError, KeyError):
        return []
    return [(scene, method) for scene, method in named]


def run_again(results: Path) -> str:
    """Return the shell command that runs a run again."""
    home = results.resolve().parent
    try:
        stored = read_manifest(results / RUN)["options"]
    except (StoreError, KeyError):
        stored = ["--configfile", "SETTINGS_OF_THAT_RUN"]
        return shlex.join([program("rfpipe"), "run", "--directory", str(home), *stored])
    options, name = list[str](), ""
    for option in stored:
        name = option if option.startswith("--") else name
        is_path = name in (_SNAKEFILE, _CONFIGFILE) and option != name
        options.append(str(home / option) if is_path else option)
    return shlex.join([program("rfpipe"), "run", "--directory", str(home), *options])


def _relative_to(home: Path, path: Path) -> str:
    """Path relative to a folder, for a file in it, or else the absolute path."""
    path = path.resolve()
    return path.relative_to(home).as_posix() if path.is_relative_to(home) else str(path)


def notify(command: str | None, status: Literal["done", "failed"], log: str) -> None:
    """Run the user's command at the end of a run, which may be at night.

    Parameters
    ----------
    command : str or None
        A program and its arguments, quoted as for a shell, which isn't used. It finds
        ``RFPIPE_STATUS`` and ``RFPIPE_LOG`` in its environment and has a minute. None does nothing.
    log : str
        Snakemake's log file.
    """
    if command is None:
        return
    environment = {**os.environ, "RFPIPE_STATUS": status, "RFPIPE_LOG": log}
    try:
        subprocess.run(shlex.split(command), env=environment, timeout=_PATIENCE_SECONDS, check=True)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        print(f"rfpipe: notify: {command!r} failed: {error}", file=sys.stderr)


def list_changed_parameters_alone() -> None:
    """Let ``--list-changes params`` list outputs of changed parameters, not every output.

    Snakemake 9 lists the outputs of jobs whose parameters are the same, too.
    """
    from snakemake.persistence import ParamsChange

    ParamsChange.__iter__ = lambda change: iter(change.files if change else ())


def explain_reruns() -> None:
    """Let a run explain jobs that changed settings trigger, in place of Snakemake's advice.

    Snakemake advises to look at times alone, or to remove its records, by which results of other
    settings would stay.
    """
    from snakemake.workflow import Workflow

    def log_reasons(workflow: Any) -> None:
        reasons = map(workflow.dag.reason, workflow.dag.needrun_jobs(exclude_finished=False))
        if any(reason.is_provenance_triggered() for reason in reasons):
            logging.getLogger("snakemake.logging").info(
                "Settings or code changed; config/README.md lists which change runs what again."
            )

    Workflow.log_provenance_info = log_reasons


def say_failed_jobs(logger: logging.Logger) -> None:
    """Let Snakemake say by what jobs failed on other machines, of which its profile is quiet."""
    from snakemake.logging import DefaultFormatter
    from snakemake_interface_logger_plugins.common import LogEvent

    failures = (LogEvent.JOB_ERROR, LogEvent.GROUP_ERROR)
    handler = logging.StreamHandler()
    handler.setFormatter(DefaultFormatter(show_failed_logs=True))
    handler.addFilter(lambda record: getattr(record, "event", None) in failures)
    logger.addHandler(handler)
