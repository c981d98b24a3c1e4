"""Starts Snakemake by forking a process that has already loaded its libraries.

Loading takes Snakemake three seconds and the process from which it forks its jobs two, which is
most of the time of a small run. As a program, this module reads one line of JSON per run from
standard input and prints the exit status. Each run is a new process, forked before any run; all
runs fork their jobs from the same processes.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import NoReturn

__all__ = ["SNAKEMAKE", "run_snakemake"]

SNAKEMAKE = Path(sys.executable).with_name("snakemake")

# Modules that Snakemake loads late, or that the rules load, directly or as plug-ins.
_OF_SNAKEMAKE = (
    "nbformat",
    "smart_open",
    "rfpipe.config.files",
    "rfpipe.methods.brute_force",
    "rfpipe.methods.dual",
    "rfpipe.methods.symmetric.method",
    "rfpipe.scenes.rooms",
    "rfpipe.storage.run_record",
    "rfpipe.stages.plan",
    "rfpipe.jobs.snakemake",
)
_THREADS = (1, 2)  # of a job, as the tests run Snakemake on two cores


def run_snakemake(arguments: Sequence[str], folder: Path, patience: float) -> tuple[int, str]:
    """Run Snakemake in a folder, as from a shell; return its exit status and output."""
    with NamedTemporaryFile("r", errors="replace") as output:
        starter = _starter()
        assert starter.stdin
        assert starter.stdout
        request = [str(folder), output.name, dict(os.environ), list(arguments)]
        starter.stdin.write(f"{json.dumps(request)}\n")
        starter.stdin.flush()
        if not select.select([starter.stdout], [], [], patience)[0]:
            _starter.cache_clear()
            _end(starter)
            raise AssertionError(f"Snakemake took more than {patience} s: {output.read()}")
        return int(starter.stdout.readline()), output.read()


@cache
def _starter() -> subprocess.Popen[str]:
    starter = subprocess.Popen(
        [sys.executable, __file__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    atexit.register(_end, starter)
    return starter


def _end(starter: subprocess.Popen[str]) -> None:
    if starter.poll() is None:
        os.killpg(starter.pid, signal.SIGKILL)  # its group includes the runs and jobs
    starter.communicate()


def _serve() -> None:
    from rfpipe.jobs.forked_scripts import SERVERS
    from rfpipe.provenance import code_digest

    for threads in _THREADS:
        SERVERS.start(threads)
    from snakemake.cli import get_argument_parser

    get_argument_parser()  # loads the plug-ins, for their options
    for name in _OF_SNAKEMAKE:
        import_module(name)
    for pages in (False, True):
        code_digest(pages=pages)  # cached for all runs
    for line in sys.stdin:
        process = os.fork()
        if process == 0:
            _become_snakemake(*json.loads(line))
        _, status = os.waitpid(process, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def _become_snakemake(
    folder: str, output: str, environment: dict[str, str], arguments: list[str]
) -> NoReturn:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    log = os.open(output, os.O_WRONLY)
    for number, descriptor in enumerate([os.open(os.devnull, os.O_RDONLY), log, log]):
        os.dup2(descriptor, number)
    sys.path[0] = str(SNAKEMAKE.parent)
    sys.argv = [str(SNAKEMAKE), *arguments]
    from snakemake.cli import main

    sys.exit(main())


if __name__ == "__main__":
    _serve()
