"""Where Snakemake itself runs: how a run was started, and what is said when jobs or a run end."""

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
    """Refuse a path that Snakemake can't have: it takes braces in it for wildcards.

    Of a run's folder, Snakemake then finds no locks or those of other folders. Raises InputError.
    """
    if any(brace in str(path) for brace in "{}"):
        raise InputError(
            f"{name} is {path}; Snakemake takes braces in a path for wildcards. Use a folder "
            "without braces in its name and in those above it"
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
