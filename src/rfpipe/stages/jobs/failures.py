"""What became of jobs that failed on other machines, said where Snakemake itself runs.

A stage that fails here says so on the terminal. One that fails on a cluster says it in a log of the
scheduler's, and Snakemake, told to be quiet about rules, says nothing of jobs that a scheduler
refuses.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

__all__ = ["FailedJobs"]

_LOGS = Path(".snakemake") / "cluster_logs"  # as the profile cluster-generic has them
_LINES = 12  # of a job's log: a traceback's end, and what the stage says
# of Snakemake in a job: the last line before what the job says, and those about its own end
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
_SEE_LOGS = "For further error details see"


class FailedJobs(logging.Handler):
    """Tell of each job that failed: by what, and the end of its log.

    Parameters
    ----------
    tell : callable
        Called with some lines of text for each.
    """

    def __init__(self, tell: Callable[[str], object]) -> None:
        super().__init__(logging.ERROR)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        """Tell of a record of Snakemake's, if it is about a job that failed."""
        event = getattr(record, "event", None)
        what: Any = record
        if event == "job_error" and not what.indent:  # those of a group are told with it
            number = what.aux.get("external_jobid")
            # of one that was refused there are logs of earlier times at most
            logs = [*what.log, *map(str, _LOGS.glob(f"*-{number}.log"))] if number else []
            said = [f"rfpipe: {what.rule_name} failed{f' as job {number}' if number else ''}"]
            ends = _ends(logs) or ([_NO_LOG] if number else [])
            self._tell("\n".join([*said, *_said(what.rule_msg or ""), *ends]))
        elif event == "group_error":
            rules = ", ".join(sorted(info["rule_name"] for info in what.job_error_info))
            logs = [*what.aux_logs, *(log for info in what.job_error_info for log in info["log"])]
            ends = _ends(logs) or ["    run again without groups to see why"]
            self._tell("\n".join([f"rfpipe: a group failed, of {rules}", *ends]))


def _said(message: str) -> list[str]:
    """Return what a scheduler said, without the script that it was given."""
    lines = message.partition(_SEE_LOGS)[0].strip().splitlines()
    told = []
    for line in lines:
        if line.lstrip().startswith(("sbatch call:", "sbatch script:")):
            break
        told.append(f"    {line.strip()}")
    return told


def _ends(logs: Iterable[str]) -> list[str]:
    """Return the last lines of the last of these logs that has any, and its name."""
    for log in reversed([*logs]):
        try:
            lines = Path(log).read_text(errors="replace").splitlines()
        except OSError:
            continue
        begins = max((n for n, line in enumerate(lines, 1) if line.startswith(_BEFORE)), default=0)
        told = [f"    {line}" for line in lines[begins:] if not _NOISE.match(line)][-_LINES:]
        if told:
            return [*told, f"    ({log})"]
    return []
