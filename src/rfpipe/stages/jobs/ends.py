"""Where Snakemake itself runs: how a run was started, and what is said when jobs or a run end."""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal

from rfpipe.errors import StoreError
from rfpipe.store import read_manifest, write_manifest

RUN = "run.json"
"""Lies in ``results``: how the run was started."""

_PATIENCE_SECONDS = 60
_LOGS = Path(".snakemake") / "cluster_logs"  # as the profile cluster-generic has them
_LINES = 30  # of a job's log: the stage's message, and what Snakemake says behind it
_NO_LOG = (
    "    it left no log: does its machine see this folder, under the same path (docs/clusters.md)?"
)


def snakemake_program() -> str:
    """Return the path of the Snakemake that is installed beside rfpipe, or its name."""
    beside = Path(sys.executable).with_name("snakemake")
    return str(beside) if beside.exists() else shutil.which("snakemake") or "snakemake"


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
    return shlex.join([snakemake_program(), "--directory", home, *options])


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


class FailedJobs(logging.Handler):
    """Says of each job that failed on another machine by what, with the end of its log.

    Parameters
    ----------
    tell : callable
        Called with some lines of text for each.
    """

    def __init__(self, tell: Callable[[str], object]) -> None:
        super().__init__(logging.ERROR)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        """Tell of a record of Snakemake's, if it is about a job or a group that failed."""
        event = getattr(record, "event", None)
        what: Any = record
        if event == "job_error" and not what.indent:  # jobs of a group are told of with it
            number = what.aux.get("external_jobid")
            # of a job that was refused there are logs of earlier times at most
            logs = [*what.log, *map(str, _LOGS.glob(f"*-{number}.log"))] if number else []
            scheduler = (what.rule_msg or "").partition("sbatch call:")[0].strip().splitlines()
            title = f"rfpipe: {what.rule_name} failed{f' as job {number}' if number else ''}"
            lines = [f"    {line.strip()}" for line in scheduler]
            ends = _end(logs) or [_NO_LOG] * bool(number)
            self._tell("\n".join([title, *lines, *ends]))
        elif event == "group_error":
            jobs = what.job_error_info
            rules = ", ".join(sorted(job["rule_name"] for job in jobs))
            ends = _end([*what.aux_logs, *(log for job in jobs for log in job["log"])])
            self._tell("\n".join([f"rfpipe: a group failed, of {rules}", *(ends or [_NO_LOG])]))


def _end(logs: Iterable[str]) -> list[str]:
    """Return the last lines of the last of these logs that has any, and its name."""
    for log in reversed([*logs]):
        path = Path(log)
        lines = path.read_text(errors="replace").splitlines() if path.is_file() else []
        if lines:
            return [*(f"    {line}" for line in lines[-_LINES:]), f"    ({log})"]
    return []
