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

from rfpipe.errors import StoreError
from rfpipe.store import read_manifest, write_manifest

RUN = "run.json"
"""Lies in ``results``: how the run was started."""

_PATIENCE_SECONDS = 60


def program(name: str) -> str:
    """Return the path of a program that is installed beside this Python, or its name."""
    beside = Path(sys.executable).with_name(name)
    return str(beside) if beside.exists() else shutil.which(name) or name


def write_run(
    results: Path, snakefile: Path, configfiles: Iterable[Path], overrides: dict[str, Any]
) -> None:
    """Keep how a run was started: its files, and the settings given on the command line."""
    options = ["--snakefile", str(snakefile.resolve())]
    for name, values in (
        ("--configfile", [str(path.resolve()) for path in configfiles]),
        ("--config", [f"{name}={value}" for name, value in overrides.items()]),
    ):
        options += [name, *values] if values else []
    write_manifest(results / RUN, {"options": options})


def run_again(results: Path) -> str:
    """Return the shell command that runs a run again."""
    try:
        options = read_manifest(results / RUN)["options"]
    except (StoreError, KeyError):
        options = ["--configfile", "SETTINGS_OF_THAT_RUN"]
    home = str(results.resolve().parent)
    return shlex.join([program("rfpipe"), "run", "--directory", home, *options])


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


def say_failed_jobs(logger: logging.Logger) -> None:
    """Let Snakemake say by what jobs failed on other machines, of which its profile is quiet."""
    from snakemake.logging import DefaultFormatter
    from snakemake_interface_logger_plugins.common import LogEvent

    failures = (LogEvent.JOB_ERROR, LogEvent.GROUP_ERROR)
    handler = logging.StreamHandler()
    handler.setFormatter(DefaultFormatter(show_failed_logs=True))
    handler.addFilter(lambda record: getattr(record, "event", None) in failures)
    logger.addHandler(handler)
