"""The option of commands whose work may be done elsewhere."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.config.addresses import check_workers
from rfpipe.errors import InputError

if TYPE_CHECKING:
    from rfpipe.stages.jobs.workers import Resources

__all__ = ["WorkersOption", "resources_of"]

WorkersOption = Annotated[
    str,
    typer.Option(
        "--workers",
        envvar="RFPIPE_WORKERS",
        metavar="WHERE",
        help="Where to work: threads, or the workers of a dask scheduler, by its address, as "
        "tcp://localhost:8786. Files have the same bytes; docs/parallel.md tells what pays.",
    ),
]


def resources_of(workers: str) -> Resources:
    """Return what a command may use: every core that it may run on.

    Raises
    ------
    InputError
        When `workers` is no place to work.
    """
    from rfpipe.stages.jobs.workers import Resources

    try:
        check_workers(workers)
    except ValueError as error:
        raise InputError(f"--workers {workers}: it {error}") from None
    return Resources(threads=len(os.sched_getaffinity(0)), where=workers)
