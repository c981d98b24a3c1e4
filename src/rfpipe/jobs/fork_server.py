"""Process that loads the libraries of jobs once, and forks a process for each job.

Started as ``python -m rfpipe.jobs.fork_server CHANNEL``, where CHANNEL is the descriptor of a
socket. Each byte on the channel requests a job, and carries four descriptors: a socket for the job,
and its standard input, output and error. The job reads its `Request` from its socket, and writes a
line with its process number. At its end, the server adds a line with its exit status.
"""

from __future__ import annotations

import gc
import json
import os
import runpy
import select
import signal
import socket
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, NoReturn

_LIBRARIES = (
    "email.parser",
    "jinja2",
    "multiprocessing.synchronize",
    "numba",
    "pandas",
    "rfpipe.environment",
    "rfpipe.lights.shading",
    "rfpipe.methods.auto",
    "rfpipe.methods.dual",
    "rfpipe.methods.footprints.method",
    "rfpipe.methods.near_far.method",
    "rfpipe.methods.symmetric.classification_kernels",
    "rfpipe.methods.symmetric.method",
    "rfpipe.methods.symmetric.piece_kernels",
    "rfpipe.report",
    "rfpipe.scenes.rooms",
    "rfpipe.stages.acquisition",
    "rfpipe.stages.evaluate",
    "rfpipe.stages.job",
    "rfpipe.stages.relight",
    "rfpipe.stages.verification",
    "rfpipe.transport.hierarchical.kernels",
    "rfpipe.transport.response_kernels",
    "rfpipe.viewer",
    "rustworkx",
    "scipy.ndimage",
    "scipy.sparse.linalg",
    "snakemake.script",
    "zarr",
)
"""Modules of jobs, except libraries that only a single job of a run uses, such as matplotlib."""

_IGNORED = (signal.SIGINT, signal.SIGTERM)

DESCRIPTORS = 4
"""Number of descriptors that a request carries."""


class Request(NamedTuple):
    """A job to run.

    Attributes
    ----------
    folder : str
        Working folder.
    environment : dict of str to str
        All environment variables.
    script : str
        Path of the Python script, absolute or relative to `folder`.
    """

    folder: str
    environment: dict[str, str]
    script: str


def _load_libraries() -> None:
    """Load the modules of jobs, and prepare numba to run kernels."""
    for name in _LIBRARIES:
        import_module(name)
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    gc.collect()
    gc.freeze()  # jobs share the memory of these objects


def serve(channel: socket.socket) -> None:
    """Load the libraries, and fork a process for each request until the channel's end.

    Ctrl-C in a terminal reaches all processes of a run. This process ignores the signal, as well as
    SIGTERM, and reports how its jobs end.
    """
    handlers = {number: signal.signal(number, signal.SIG_IGN) for number in _IGNORED}
    _load_libraries()
    child_ended, on_signal = socket.socketpair()
    on_signal.setblocking(False)
    signal.set_wakeup_fd(on_signal.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    jobs: dict[int, socket.socket] = {}
    while True:
        ready, _, _ = select.select([channel, child_ended], [], [])
        if child_ended in ready:
            child_ended.recv(4096)
            _report_ended(jobs)
        if channel in ready:
            _, descriptors, _, _ = socket.recv_fds(channel, 1, DESCRIPTORS)
            if not descriptors:
                return
            connection = socket.socket(fileno=descriptors[0])
            process = os.fork()
            if process == 0:
                signal.set_wakeup_fd(-1)
                for number, handler in {**handlers, signal.SIGCHLD: signal.SIG_DFL}.items():
                    signal.signal(number, handler)
                for other in (channel, child_ended, on_signal, *jobs.values()):
                    other.close()
                _run(connection, descriptors[1:])
            for descriptor in descriptors[1:]:
                os.close(descriptor)
            jobs[process] = connection


def _report_ended(jobs: dict[int, socket.socket]) -> None:
    """Send the exit status of each job that ended, and forget the job."""
    with suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            process, status = ended
            with jobs.pop(process) as connection, suppress(OSError):  # Snakemake may be gone
                connection.sendall(f"{os.waitstatus_to_exitcode(status)}\n".encode())


def _run(connection: socket.socket, standard_streams: list[int]) -> NoReturn:
    """Run a job in this process, and end it."""
    with connection:
        connection.sendall(f"{os.getpid()}\n".encode())
        with connection.makefile("rb") as stream:
            request = Request(*json.load(stream))
    os.chdir(request.folder)
    os.environ.clear()
    os.environ.update(request.environment)
    for number, descriptor in enumerate(standard_streams):
        os.dup2(descriptor, number)
    sys.path[0] = str(Path(request.script).parent)
    sys.argv = [request.script]
    runpy.run_path(request.script, run_name="__main__")
    sys.exit()


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
