"""Starts Snakemake and its jobs by forking processes that have already loaded their libraries.

Loading takes Snakemake three seconds and a job two, which is most of the time of a small run. As a
program, this module reads one line of JSON per run from standard input and prints the exit status.
Each run and each job is a new process, forked before any run. The process from which jobs are
forked has loaded libraries only, no module of rfpipe.
"""

from __future__ import annotations

import atexit
import json
import os
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from tempfile import NamedTemporaryFile, mkdtemp
from typing import Any, NoReturn

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
_OF_JOBS = (
    "colour",
    "matplotlib.backends.backend_agg",
    "numba",
    "pandas",
    "pydantic",
    "scipy.ndimage",
    "scipy.sparse.linalg",
    "snakemake.script",
    "zarr",
)


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
    # no `with`, since forked processes also leave this function
    folder = mkdtemp()
    address = f"{folder}/jobs"
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    jobs = os.fork()
    if jobs == 0:
        _serve_jobs(listener)
    listener.close()
    from snakemake.cli import get_argument_parser

    get_argument_parser()  # loads the plug-ins, for their options
    for name in _OF_SNAKEMAKE:
        import_module(name)
    for line in sys.stdin:
        process = os.fork()
        if process == 0:
            _become_snakemake(*json.loads(line), address)
        _, status = os.waitpid(process, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)
    os.kill(jobs, signal.SIGKILL)
    shutil.rmtree(folder)


def _serve_jobs(listener: socket.socket) -> NoReturn:
    """Fork a process for each job, until the parent process kills this one."""
    for name in _OF_JOBS:
        import_module(name)
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # no zombies
    while True:
        connection, _ = listener.accept()
        if os.fork() == 0:
            break
        connection.close()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    head, descriptors, _, _ = socket.recv_fds(connection, 8, 3)
    job = connection.makefile("rb").read(int.from_bytes(head, "big"))
    process = os.fork()
    if process == 0:
        connection.close()
        _become_job(descriptors, *json.loads(job))
    for descriptor in descriptors:
        os.close(descriptor)
    _, status = os.waitpid(process, 0)
    connection.sendall(os.waitstatus_to_exitcode(status).to_bytes(8, "big", signed=True))
    os._exit(0)


def _become(folder: str, environment: dict[str, str], descriptors: Sequence[int]) -> None:
    """Take over the folder, environment and standard streams of a new process."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for number, descriptor in enumerate(descriptors):
        os.dup2(descriptor, number)


def _become_snakemake(
    folder: str, output: str, environment: dict[str, str], arguments: list[str], address: str
) -> NoReturn:
    log = os.open(output, os.O_WRONLY)
    _become(folder, environment, [os.open(os.devnull, os.O_RDONLY), log, log])
    sys.path[0] = str(SNAKEMAKE.parent)
    sys.argv = [str(SNAKEMAKE), *arguments]
    from snakemake.cli import main
    from snakemake.script import PythonScript

    command = f"{sys.executable} -IS {Path(__file__).with_name('job.py')} {address} {{script:q}}"

    def execute_script(self: Any, fname: str, edit: bool = False) -> None:
        self._execute_cmd(command, script=fname, is_python_script=True)

    PythonScript.execute_script = execute_script
    sys.exit(main())


def _become_job(
    descriptors: Sequence[int], folder: str, environment: dict[str, str], script: str
) -> NoReturn:
    _become(folder, environment, descriptors)
    os.environ.setdefault("NUMBA_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    import numba
    from numba.np.ufunc import parallel

    numba.config.reload_config()  # both were set when numba was imported
    parallel.NUM_THREADS = numba.config.NUMBA_NUM_THREADS
    sys.path[0] = str(Path(script).parent)
    sys.argv = [script]
    runpy.run_path(script, run_name="__main__")
    sys.exit()


if __name__ == "__main__":
    _serve()
