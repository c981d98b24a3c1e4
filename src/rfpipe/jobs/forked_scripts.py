"""Scripts of a run's jobs, in processes forked from one that has loaded their libraries.

A new Python process takes about two seconds to load the libraries of a job, which is most of the
time of a small job. `ForkServers` has them loaded once for all jobs with a given number of threads.
"""

from __future__ import annotations

import atexit
import json
import os
import shlex
import socket
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from threading import Lock
from typing import Any

from rfpipe.jobs.fork_server import DESCRIPTORS, Request
from rfpipe.platforms import can_fork

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "GOTO_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)
"""Number of threads of a job, as Snakemake sets it. Libraries read it when they are loaded."""

_FOLDER_VARIABLES = ("TMPDIR", "TMP", "TEMPDIR", "TEMP")


class ForkServers:
    """Processes from which jobs are forked, one for each number of threads."""

    def __init__(self) -> None:
        self._channels: dict[int, socket.socket] = {}
        self._processes: list[subprocess.Popen[bytes]] = []
        self._lock = Lock()

    def start(self, threads: int) -> None:
        """Start the process for jobs with a number of threads.

        It ends with this process, however that ends.
        """
        channel, of_server = socket.socketpair()
        with of_server:
            command = [sys.executable, "-m", "rfpipe.jobs.fork_server", str(of_server.fileno())]
            variables = {"NUMBA_NUM_THREADS": str(threads), **_environment(threads)}
            process = subprocess.Popen(command, env=variables, pass_fds=[of_server.fileno()])
        if threads in self._channels:
            self._channels[threads].close()
        self._channels[threads] = channel
        self._processes.append(process)

    def close(self) -> None:
        """End the processes; running jobs continue."""
        for channel in self._channels.values():
            channel.close()
        for process in self._processes:
            process.wait()
        self._channels.clear()
        self._processes.clear()

    def execute(self, script: Any, file: str) -> None:
        """Run a script of Snakemake to its end, and record its time and memory.

        Parameters
        ----------
        script : snakemake.script.PythonScript
            Its attributes `threads`, `resources` and `bench_record` are used.
        file : str
            Path of the script with Snakemake's preamble.

        Raises
        ------
        CalledProcessError
            If its exit status isn't 0.
        """
        from snakemake.benchmark import benchmarked

        environment = _environment(script.threads, script.resources.get("tmpdir"))
        with self._connect(script.threads) as connection:
            connection.sendall(json.dumps(Request(str(Path.cwd()), environment, file)).encode())
            connection.shutdown(socket.SHUT_WR)
            with connection.makefile() as answers:
                process = answers.readline()
                is_recorded = process and script.bench_record is not None
                with benchmarked(process, script.bench_record) if is_recorded else nullcontext():
                    status = int(answers.readline() or 1)
        if status:
            raise subprocess.CalledProcessError(status, shlex.join([sys.executable, file]))

    def _connect(self, threads: int) -> socket.socket:
        """Fork a process for a job; return the socket for its `Request`."""
        connection, of_job = socket.socketpair()
        descriptors = [of_job.fileno(), *range(DESCRIPTORS - 1)]
        with of_job, self._lock:
            if threads not in self._channels:
                self.start(threads)
            try:
                socket.send_fds(self._channels[threads], [b"j"], descriptors)
            except BrokenPipeError:  # the process was killed
                self.start(threads)
                socket.send_fds(self._channels[threads], [b"j"], descriptors)
        return connection


SERVERS = ForkServers()
"""Processes for the jobs of this run."""


def fork_scripts() -> None:
    """Make Snakemake run Python scripts in forked processes, on this machine.

    Scripts in conda environments and containers, and all scripts on systems other than Linux, are
    run in new processes as before.
    """
    from snakemake.script import PythonScript

    execute_in_new_process = PythonScript.execute_script

    def execute_script(script: Any, fname: str, edit: bool = False) -> None:
        environments = (script.conda_env, script.container_img, script.env_modules)
        if any(environments) or script.resources.get("shell_exec"):
            execute_in_new_process(script, fname, edit)
        else:
            SERVERS.execute(script, fname)

    if can_fork():
        PythonScript.execute_script = execute_script
        atexit.register(SERVERS.close)


def _environment(threads: int, temporary_folder: str | None = None) -> dict[str, str]:
    """Environment of a job, as Snakemake sets it."""
    variables = {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, str(threads))}
    if temporary_folder:
        variables.update(dict.fromkeys(_FOLDER_VARIABLES, temporary_folder))
    return variables
