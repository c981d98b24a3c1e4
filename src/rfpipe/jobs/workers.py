"""What a stage may use, memory and cores, and its work side by side within that.

The workers of a `dask.distributed` cluster share the results' file system.
"""

from __future__ import annotations

import logging
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from rfpipe.config.addresses import THREADS
from rfpipe.errors import ClusterError
from rfpipe.provenance import code_digest, fingerprint, versions

Result = TypeVar("Result")
Work = Callable[[int, int], Result]
"""``work(first, last)`` does a piece; any thread, or process of a cluster, may call it."""

# Half of the budget is for Python with its libraries, and what an estimate leaves out.
_SHARE_FOR_DATA = 0.5
# Pieces per thread: one in hand, one to go on with.
_AHEAD = 2

_PATIENCE_SECONDS = 10
_HERE = ("localhost", "127.0.0.1")

_log = logging.getLogger(__name__)

HandOut = Callable[[Work[Any]], Callable[[int, int], Any]]
"""Takes the work and returns a function that hands out one piece of it, and returns a future."""


@dataclass(frozen=True)
class Resources:
    """Memory and cores of a job. No result depends on them.

    Parameters
    ----------
    memory_gib : float
        Peak memory of the job in GiB, above 0.
    threads : int
        Threads to work with, at least 1.
    where : str
        "threads" of this process, or the address of a dask scheduler, as ``tls://host:8786``.
    """

    memory_gib: float = 4.0
    threads: int = 1
    where: str = THREADS

    @classmethod
    def of_job(cls, snakemake: Any) -> Resources:
        """Return the resources of a job of the workflow."""
        asked = snakemake.resources
        memory_gib = asked.mem_mib / 1024
        if "memory_gib" in asked.keys():  # noqa: SIM118 - Snakemake's resources are no mapping
            memory_gib = min(memory_gib, float(asked.memory_gib))
        return cls(memory_gib, snakemake.threads, asked.get("workers") or THREADS)

    @property
    def data_bytes(self) -> int:
        """Bytes that the data in hand may take."""
        return int(self.memory_gib * 2**30 * _SHARE_FOR_DATA)

    @property
    def here(self) -> Resources:
        """The same in this process."""
        return replace(self, where=THREADS)

    def fitting(self, bytes_each: int, most: int) -> int:
        """Return how many things of a size fit into memory, from 1 to `most`."""
        return max(1, min(most, self.data_bytes // max(1, bytes_each)))

    @contextmanager
    def workers(self, bytes_each: int, folder: Path) -> Iterator[Workers]:
        """Provide workers for pieces of work that take `bytes_each` while they are in hand.

        `folder` is one that the work reads or writes; a cluster's workers must see it. Raises
        ClusterError when they don't, or the cluster doesn't answer.
        """
        if self.where != THREADS:
            with connected(self.where, folder) as (hand_out, threads):
                yield Workers(hand_out, self.fitting(bytes_each, _AHEAD * threads))
            return
        count = self.fitting(_AHEAD * bytes_each, self.threads)
        with ThreadPoolExecutor(count) as pool:
            try:
                yield Workers(partial(partial, pool.submit), _AHEAD * count if count > 1 else 1)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


@dataclass(frozen=True)
class Workers:
    """Does pieces of work, `in_flight` at a time: with their results, all that is in memory."""

    hand_out: HandOut
    in_flight: int

    def results(self, work: Work[Result], runs: Iterable[tuple[int, int]]) -> Iterator[Result]:
        """Yield ``work(first, last)`` of each run, in their order."""
        ask = self.hand_out(work)
        handed_out: deque[Any] = deque()
        for first, last in runs:
            if len(handed_out) == self.in_flight:
                yield handed_out.popleft().result()
            handed_out.append(ask(first, last))
        while handed_out:
            yield handed_out.popleft().result()


@contextmanager
def connected(address: str, folder: Path) -> Iterator[tuple[HandOut, int]]:
    """Connect to a scheduler; provide what hands out work, and the number of its workers' threads.

    Certificates are those of dask's own settings. Raises ClusterError when no scheduler with
    workers answers, or one doesn't see the folder or has another rfpipe.
    """
    import distributed

    setting = f"resources.workers is {address}"
    if not address.startswith("tls:") and urlsplit(address).hostname not in _HERE:
        text = "%s: not encrypted, and dask unpickles what it gets: use tls:// (docs/parallel.md)"
        _log.warning(text, setting)
    connect: Any = distributed.Client  # without types
    with ExitStack() as stack:
        try:
            client = stack.enter_context(
                connect(address, timeout=_PATIENCE_SECONDS, set_as_default=False)
            )
            client.wait_for_workers(1, timeout=_PATIENCE_SECONDS)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            raise ClusterError(
                f"{setting}: within {_PATIENCE_SECONDS} s no scheduler with workers answered "
                f"({error}). Start both as docs/parallel.md says, with certificates for tls://, or "
                "set it to threads"
            ) from error
        unfit = client.run(_unfit, folder.absolute(), _our_code(), on_error="return")
        for worker, reason in unfit.items():
            if reason is not None:  # an exception where there is no rfpipe, or another one
                raise ClusterError(f"{setting}: {worker} {reason}")

        def hand_out(work: Work[Any]) -> Callable[[int, int], _Promise]:
            # by a task, which is done again where the worker that has the work dies
            held = client.submit(_held, work, pure=False)
            return lambda first, last: _Promise(
                client.submit(_do, held, first, last, pure=False), setting
            )

        yield hand_out, sum(client.nthreads().values())


@dataclass(frozen=True)
class _Promise:
    future: Any  # of distributed
    setting: str

    def result(self) -> Any:
        """Wait for the result, or raise the error of the work; ClusterError where it was lost."""
        from distributed import KilledWorker

        try:
            return self.future.result()
        except (KilledWorker, CancelledError) as error:
            raise ClusterError(
                f"{self.setting}: the work was lost ({type(error).__name__}: {error}). What is "
                "done is kept. See dask's logs, a worker may have too little memory; start what is "
                "missing and run again"
            ) from error


def _held(work: Work[Result]) -> Work[Result]:
    return work


def _do(work: Work[Result], first: int, last: int) -> Result:
    """Do a piece of the work in a worker, with one thread: pieces are done side by side."""
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(1)  # of this thread alone
    else:
        os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    return work(first, last)


def _unfit(folder: Path, code: str) -> str | None:
    """Return why this process can't do the work, or None."""
    if not folder.is_dir():
        return f"does not see {folder}. Mount it there, under the same path"
    if code != _our_code():
        return "runs another version of rfpipe or what it rests on. Install the same and restart it"
    return None


@cache
def _our_code() -> str:
    return fingerprint([code_digest(), versions()])


def machine_memory_mb() -> int:
    """Return the memory of this machine, or its control group's share of it, in MB."""
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # no groups, or "max"
        have = min(have, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return have // 10**6
