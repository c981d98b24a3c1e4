"""Work in processes of this machine, any of which may be killed: its piece is done again."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from types import ModuleType
from typing import Any

from rfpipe.errors import ClusterError
from rfpipe.stages.jobs.sent import Sent, sending

__all__ = ["Processes", "started"]

# How often a piece of work is done again after its process died: as often as dask does.
_LIVES = 3


class Processes:
    """Processes that do pieces of work; new ones where one of them died.

    Parameters
    ----------
    count : int
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool = _pool(count)
        self._submitting = threading.Lock()
        self._ended = False

    def submit(self, sent: Sent, first: int, last: int) -> Future[Any]:
        """Ask for a piece of work; processes are made anew where one died meanwhile."""
        with self._submitting, _no_main():
            try:
                return self._pool.submit(sent, first, last)
            except BrokenProcessPool:
                if self._ended:  # by us: whoever waits for results isn't to start others
                    raise ClusterError("the processes have ended with the work") from None
                self._pool = _pool(self.count)
                return self._pool.submit(sent, first, last)

    def close(self, *, at_once: bool) -> None:
        """End the processes: at once, or when they have done what they have begun."""
        with self._submitting:
            self._ended = True
        running = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=not at_once, cancel_futures=True)
        if at_once:  # a piece may be cut off anywhere, as by kill -9
            for process in running:
                process.kill()


@dataclass
class _Promise:
    processes: Processes
    sent: Sent
    first: int
    last: int
    future: Future[Any]

    def result(self) -> Any:
        """Wait for the result, or raise what the work raised."""
        for _ in range(_LIVES):
            try:
                return self.future.result()
            except BrokenProcessPool:
                self.future = self.processes.submit(self.sent, self.first, self.last)
        try:
            return self.future.result()
        except BrokenProcessPool as error:
            raise ClusterError(
                f"processes died {_LIVES + 1} times at the same piece of work, {self.first} to "
                f"{self.last - 1}. There may be too little memory: set resources.workers to "
                "threads, or lower resources.memory_gib"
            ) from error


@contextmanager
def started(count: int, folder: Path) -> Iterator[Callable[[Any], Callable[[int, int], _Promise]]]:
    """Start processes; provide what hands work out to them.

    Parameters
    ----------
    count : int
    folder : Path
        One that the work reads from or writes to.
    """
    processes = Processes(count)
    with sending(folder) as send:

        def hand_out(work: Any) -> Callable[[int, int], _Promise]:
            sent = send(work)

            def ask(first: int, last: int) -> _Promise:
                future = processes.submit(sent, first, last)
                return _Promise(processes, sent, first, last, future)

            return ask

        try:
            yield hand_out
        except BaseException:
            processes.close(at_once=True)
            raise
        processes.close(at_once=False)


def _pool(count: int) -> ProcessPoolExecutor:
    # not forked: threads of this process may hold locks
    return ProcessPoolExecutor(count, get_context("spawn"), _begin)


def _begin() -> None:
    """Leave Ctrl-C to whoever started this process, and end when that one does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _no_main() -> Iterator[None]:
    """Hide the main program from processes that start: they would run a script once more."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
