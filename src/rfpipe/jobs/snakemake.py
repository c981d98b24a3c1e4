"""Adaptations of Snakemake: messages on reruns and failures, and a notification at the end."""

from __future__ import annotations

import logging
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, Literal

from rfpipe.errors import InputError

_PATIENCE_SECONDS = 60


def check_no_braces(name: str, path: str | Path) -> None:
    """Raise InputError for a path with braces, in which Snakemake would see wildcards.

    In such a run's folder, Snakemake doesn't find its locks, or finds locks of another folder.

    Parameters
    ----------
    name : str
        Name of the setting or option.
    path : str or Path
    """
    if any(brace in str(path) for brace in "{}"):
        raise InputError(
            f"{name} is {path}; Snakemake reads braces in a path as wildcards",
            remedy="Use a folder whose path has no braces",
        )


def notify(command: str | None, status: Literal["done", "failed"], log: str) -> None:
    """Run the user's command at the end of a run.

    Parameters
    ----------
    command : str or None
        A program and its arguments, quoted as for a shell, but run without one; its environment has
        ``RFPIPE_STATUS`` and ``RFPIPE_LOG``, and it is ended after a minute. None: no command.
    status : {"done", "failed"}
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
    """Make ``--list-changes params`` list only outputs whose parameters changed.

    Snakemake 9 also lists the outputs of jobs whose parameters are the same.
    """
    from snakemake.persistence import ParamsChange

    ParamsChange.__iter__ = lambda change: iter(change.files if change else ())


def explain_reruns() -> None:
    """Make a run explain jobs that changed settings trigger, instead of giving Snakemake's advice.

    Snakemake advises to compare only file times, or to remove its records; both would keep results
    of other settings.
    """
    from snakemake.workflow import Workflow

    def log_reasons(workflow: Any) -> None:
        reasons = map(workflow.dag.reason, workflow.dag.needrun_jobs(exclude_finished=False))
        if any(reason.is_provenance_triggered() for reason in reasons):
            logging.getLogger("snakemake.logging").info(
                "Settings or code changed; config/README.md lists what each change reruns."
            )

    Workflow.log_provenance_info = log_reasons


def say_failed_jobs(logger: logging.Logger) -> None:
    """Make Snakemake print why jobs failed on other machines, which its profile suppresses."""
    from snakemake.logging import DefaultFormatter
    from snakemake_interface_logger_plugins.common import LogEvent

    failures = (LogEvent.JOB_ERROR, LogEvent.GROUP_ERROR)
    handler = logging.StreamHandler()
    handler.setFormatter(DefaultFormatter(show_failed_logs=True))
    handler.addFilter(lambda record: getattr(record, "event", None) in failures)
    logger.addHandler(handler)
