"""Memory and threads of a job, and parallel work within them, on this machine or on a cluster.

The workers of a `dask.distributed` cluster must share the file system of the results.
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

import psutil

from rfpipe.config.addresses import THREADS
from rfpipe.errors import ClusterError
from rfpipe.provenance import code_digest, fingerprint, versions

Result = TypeVar("Result")
Work = Callable[[int, int], Result]
"""``work(first, last)`` does a piece of work; called by any thread, or process of a cluster."""

_SHARE_FOR_DATA = 0.5
"""Share of the memory for data; the remainder is for Python, libraries and estimation errors."""

_PIECES_PER_THREAD = 2
"""Pieces of work handed out per thread, so that a thread never waits for its next piece."""

_PATIENCE_SECONDS = 10
_LOCAL_HOSTS = ("localhost", "127.0.0.1")

_log = logging.getLogger(__name__)

Submit = Callable[[int, int], Any]
"""``submit(first, last)`` starts a piece of work and returns its future."""

HandOut = Callable[[Work[Any]], Submit]
"""Returns the function that submits pieces of some work."""


@dataclass(frozen=True)
class Resources:
    """Memory and threads of a job; no result depends on them.

    Parameters
    ----------
    memory_gib : float
        Peak memory of the job in GiB, above 0.
    threads : int
        Number of threads, at least 1.
    where : str
        "threads" of this process, or the address of a dask scheduler, such as
        ``tls://host:8786``.
    """

    memory_gib: float = 4.0
    threads: int = 1
    where: str = THREADS

    @classmethod
    def of_job(cls, snakemake: Any) -> Resources:
        """Return the resources of a job of the workflow."""
        resources = snakemake.resources
        memory_gib = resources.mem_mib / 1024
        if "memory_gib" in resources.keys():  # noqa: SIM118 - Snakemake's resources are no mapping
            memory_gib = min(memory_gib, float(resources.memory_gib))
        return cls(memory_gib, snakemake.threads, resources.get("workers") or THREADS)

    @property
    def data_bytes(self) -> int:
        """Memory for data in bytes."""
        return int(self.memory_gib * 2**30 * _SHARE_FOR_DATA)

    @property
    def local(self) -> Resources:
        """The same resources, with the threads of this process."""
        return replace(self, where=THREADS)

    def fitting_count(self, bytes_per_item: int, limit: int) -> int:
        """Return the number of items of a size that fit into memory, from 1 to `limit`."""
        return max(1, min(limit, self.data_bytes // max(1, bytes_per_item)))

    @contextmanager
    def blas_threads(self) -> Iterator[None]:
        """Limit the threads of matrix products to `threads`.

        BLAS takes one thread for each core by default. Its threads wait actively for each other, so
        that small products take several times as long where other programs are running.
        """
        from threadpoolctl import threadpool_limits

        with threadpool_limits(self.threads, user_api="blas"):
            yield

    @contextmanager
    def workers(self, bytes_per_piece: int, folder: Path) -> Iterator[Workers]:
        """Provide workers for pieces of work.

        Parameters
        ----------
        bytes_per_piece : int
            Memory of a piece of work in bytes.
        folder : Path
            Folder that the work reads or writes.

        Raises
        ------
        ClusterError
            If the cluster doesn't answer, or its workers don't see the folder.
        """
        if self.where != THREADS:
            with connected(self.where, folder) as (hand_out, threads):
                yield Workers(
                    hand_out, self.fitting_count(bytes_per_piece, _PIECES_PER_THREAD * threads)
                )
            return
        count = self.fitting_count(_PIECES_PER_THREAD * bytes_per_piece, self.threads)
        with ThreadPoolExecutor(count) as pool:
            try:
                yield Workers(
                    partial(partial, pool.submit), _PIECES_PER_THREAD * count if count > 1 else 1
                )
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


@dataclass(frozen=True)
class Workers:
    """Parallel workers.

    Attributes
    ----------
    hand_out : callable
        See `HandOut`.
    in_flight : int
        Number of pieces handed out at a time, including finished ones whose result isn't used yet.
    """

    hand_out: HandOut
    in_flight: int

    def results(self, work: Work[Result], pieces: Iterable[tuple[int, int]]) -> Iterator[Result]:
        """Yield ``work(first, last)`` for each piece, in their order."""
        submit = self.hand_out(work)
        futures: deque[Any] = deque()
        for first, last in pieces:
            if len(futures) == self.in_flight:
                yield futures.popleft().result()
            futures.append(submit(first, last))
        while futures:
            yield futures.popleft().result()


@contextmanager
def connected(address: str, folder: Path) -> Iterator[tuple[HandOut, int]]:
    """Connect to a dask scheduler.

    Certificates come from dask's settings.

    Yields
    ------
    hand_out : callable
        See `HandOut`.
    threads : int
        Number of threads of all workers.

    Raises
    ------
    ClusterError
        If no scheduler with workers answers, or a worker doesn't see the folder or has another
        version of rfpipe.
    """
    import distributed

    setting = f"resources.workers is {address}"
    if not address.startswith("tls:") and urlsplit(address).hostname not in _LOCAL_HOSTS:
        text = (
            "%s: not encrypted, and dask unpickles what it receives: use tls:// (docs/parallel.md)"
        )
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
                f"({error})",
                remedy="Start both as docs/parallel.md says, with certificates for tls://, or "
                "set it to threads",
            ) from error
        unfit = client.run(_unfit, folder.absolute(), _our_code(), on_error="return")
        for worker, reason in unfit.items():
            if reason is not None:  # an exception without rfpipe, or with another version
                raise ClusterError(f"{setting}: {worker} {reason}")

        def hand_out(work: Work[Any]) -> Submit:
            # as a task, which dask repeats if the worker that holds the work dies
            remote_work = client.submit(_identity, work, pure=False)
            return lambda first, last: _Future(
                client.submit(_do, remote_work, first, last, pure=False), setting
            )

        yield hand_out, sum(client.nthreads().values())


@dataclass(frozen=True)
class _Future:
    """Future of dask, whose loss raises ClusterError."""

    future: Any
    setting: str

    def result(self) -> Any:
        """Wait for the result; raise the error of the work, or ClusterError if it was lost."""
        from distributed import KilledWorker

        try:
            return self.future.result()
        except (KilledWorker, CancelledError) as error:
            raise ClusterError(
                f"{self.setting}: the work was lost ({type(error).__name__}: {error}). Finished "
                "work is kept",
                remedy="See dask's logs: a worker may have too little memory. Start missing "
                "workers and run again",
            ) from error


def _identity(work: Work[Result]) -> Work[Result]:
    return work


def _do(work: Work[Result], first: int, last: int) -> Result:
    """Do a piece of work in a worker, with one thread, since pieces run in parallel."""
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(1)  # for this thread only
    else:
        os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    return work(first, last)


def _unfit(folder: Path, code: str) -> str | None:
    """Return the reason why this process can't do the work, or None."""
    if not folder.is_dir():
        return f"does not see {folder}. Mount it there, under the same path"
    if code != _our_code():
        return "runs another version of rfpipe or its dependencies. Install the same and restart it"
    return None


@cache
def _our_code() -> str:
    return fingerprint([code_digest(), versions()])


def machine_memory_mb() -> int:
    """Return the memory of this machine, or the limit of its control group, in MB."""
    available = int(psutil.virtual_memory().total)
    with suppress(OSError, ValueError):  # no groups, or "max"
        available = min(available, int(Path("/sys/fs/cgroup/memory.max").read_text("utf-8")))
    return available // 10**6
