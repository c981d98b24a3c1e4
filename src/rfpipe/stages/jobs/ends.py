"""Where Snakemake itself runs: a check before a run, and what is said when jobs or a run end."""

from __future__ import annotations

import logging
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from rfpipe.errors import ConfigError

_PATIENCE_SECONDS = 60
_LOGS = Path(".snakemake") / "cluster_logs"  # as the profile cluster-generic has them
_LINES = 12  # of a job's log: a traceback's end, and the stage's message
# A job's log has Snakemake's own lines: up to the last of these, and those at its end.
_BEFORE = "    resources:"
_NOISE = re.compile(
    r"Shutting down|Exiting because|Storing output|Elapsed time|Complete log|WorkflowError:|"
    r"At least one job|RuleException:|CalledProcessError in|Command .* returned non-zero|"
    r"Error in rule|\[\w{3} \w{3} .*\]$|\s*$|"
    r"    (message|jobid|input|output|log|benchmark|reason|wildcards):"
)
_NO_LOG = (
    "    it left no log: does its machine see this folder, under the same path (docs/clusters.md)?"
)


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


def check_groups(components: Mapping[str, int], cores: int | None) -> None:
    """Refuse groups of jobs that ask for more processors than any node of a Slurm cluster has.

    A group asks for a processor for each of its `components` (``--group-components``), up to
    `cores`; a scheduler without such a node refuses it, and the run ends.

    Raises
    ------
    ConfigError
        When `sinfo` lists no node with so many.
    """
    asked, name = max(
        ((min(count, cores or count), name) for name, count in components.items()), default=(1, "")
    )
    program = shutil.which("sinfo")
    if program is None or asked < 2:
        return
    try:
        command = [program, "--noheader", "--format=%c"]
        listed = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE_SECONDS, check=True
        ).stdout.split()
    except (OSError, subprocess.SubprocessError):
        return
    # of nodes that differ sinfo lists the least, as in 16+
    largest = max(map(int, listed)) if listed and all(map(str.isdecimal, listed)) else asked
    if asked > largest:
        raise ConfigError(
            f"group-components: {name}={components[name]} jobs side by side ask for {asked} "
            f"processors of one node (cores: {cores or 'all'}); the largest node that sinfo lists "
            f"has {largest}. Add --cores {largest}: so many jobs of a group then run at a time"
        )


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
            scheduler = (what.rule_msg or "").partition("For further error details see")[0]
            scheduler = scheduler.partition("sbatch call:")[0].partition("sbatch script:")[0]
            lines = [f"    {line.strip()}" for line in scheduler.strip().splitlines()]
            ends = _end(logs) or [_NO_LOG] * bool(number)
            title = f"rfpipe: {what.rule_name} failed{f' as job {number}' if number else ''}"
            self._tell("\n".join([title, *lines, *ends]))
        elif event == "group_error":
            jobs = what.job_error_info
            rules = ", ".join(sorted(job["rule_name"] for job in jobs))
            logs = [*what.aux_logs, *(log for job in jobs for log in job["log"])]
            ends = _end(logs) or ["    run again without groups to see why"]
            self._tell("\n".join([f"rfpipe: a group failed, of {rules}", *ends]))


def _end(logs: Iterable[str]) -> list[str]:
    """Return the last lines of the last of these logs that has any, and its name."""
    for log in reversed([*logs]):
        path = Path(log)
        lines = path.read_text(errors="replace").splitlines() if path.is_file() else []
        begin = max((n for n, line in enumerate(lines, 1) if line.startswith(_BEFORE)), default=0)
        said = [f"    {line}" for line in lines[begin:] if not _NOISE.match(line)][-_LINES:]
        if said:
            return [*said, f"    ({log})"]
    return []
