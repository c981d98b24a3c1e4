"""What a stage may use, memory and cores, and its work side by side within that.

On a `dask.distributed` cluster, whose workers share the results' file system, work lies in a file
of the folder that it reads or writes. A worker reads it once, a piece of it is a message of some
hundred bytes, and another worker can do the piece where one died.
"""

from __future__ import annotations

import logging
import os
import pickle
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar
from urllib.parse import urlsplit
from uuid import uuid4

from rfpipe.config.addresses import THREADS, check_port, check_workers
from rfpipe.errors import ClusterError, ConfigError
from rfpipe.provenance import code_digest, fingerprint, versions
from rfpipe.store.files import write_atomically

_VARIABLE = "RFPIPE_WORKERS"

Result = TypeVar("Result")
Work = Callable[[int, int], Result]
"""``work(first, last)`` does a piece; any thread, or process of a cluster, may call it."""

# Half of the budget is for Python with its libraries, and what an estimate leaves out.
_SHARE_FOR_DATA = 0.5
# Pieces per thread: one in hand, one to go on with.
_AHEAD = 2

_PATIENCE_SECONDS = 10
# A nanny starts a worker that died anew within some seconds.
_WITHOUT_WORKERS_SECONDS = 60.0
_LOOK_SECONDS = 5.0
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
        """Return the resources of a job of the workflow; RFPIPE_WORKERS overrules its settings.

        Raises ConfigError when that is no place to work.
        """
        asked = snakemake.resources
        memory_gib = asked.mem_mib / 1024
        if "memory_gib" in asked.keys():  # noqa: SIM118 - Snakemake's resources are no mapping
            memory_gib = min(memory_gib, float(asked.memory_gib))
        named = os.environ.get(_VARIABLE, "").strip()
        try:
            check_workers(named or THREADS)
        except ValueError as error:
            text = f"environment variable {_VARIABLE} is {named!r}; it {error}"
            raise ConfigError(text) from None
        return cls(memory_gib, snakemake.threads, named or asked.get("workers") or THREADS)

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

    Certificates are those of dask's own settings. The folder holds the work as long as it takes.
    Raises ClusterError when no scheduler with workers answers, or one doesn't see the folder or has
    another rfpipe.
    """
    import cloudpickle
    import distributed

    setting = f"resources.workers is {address}"
    try:
        check_port(address)
    except ValueError as error:
        raise ClusterError(f"{setting}; it {error}") from None
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

        def hand_out(work: Work[Any]) -> Callable[[int, int], _Promise]:
            path = folder.absolute() / f".work.{uuid4().hex}"
            write_atomically(path, cloudpickle.dumps(work))
            stack.callback(path.unlink, missing_ok=True)
            unfit = client.run(_unfit, path, _our_code(), on_error="return")
            for worker, reason in unfit.items():
                if reason is not None:  # an exception where there is no rfpipe, or another one
                    raise ClusterError(f"{setting}: {worker} {reason}")

            def ask(first: int, last: int) -> _Promise:
                future = client.submit(_do, path, _our_code(), first, last, pure=False)
                return _Promise(client, future, setting)

            return ask

        yield hand_out, sum(client.nthreads().values())


@dataclass(frozen=True)
class _Promise:
    client: Any
    future: Any  # of distributed
    setting: str

    def result(self) -> Any:
        """Wait for the result, or raise the error of the work; ClusterError where it was lost."""
        from distributed import KilledWorker

        seen = monotonic()
        while True:
            try:
                return self.future.result(timeout=_LOOK_SECONDS)
            except TimeoutError:
                if self.future.done():  # meanwhile, or the error is the work's own
                    return self.future.result()
            except (KilledWorker, CancelledError) as error:
                raise self._lost(f"{type(error).__name__}: {error}") from error
            if self.client.status != "running":
                raise self._lost("the scheduler is gone")
            if self.client.nthreads():
                seen = monotonic()
            elif monotonic() - seen > _WITHOUT_WORKERS_SECONDS:
                raise self._lost("all workers are gone")

    def _lost(self, why: str) -> ClusterError:
        return ClusterError(
            f"{self.setting}: the work was lost ({why}). What is done is kept. See dask's logs, a "
            "worker may have too little memory; start what is missing and run again"
        )


def _do(path: Path, code: str, first: int, last: int) -> Any:
    """Do a piece of the work in a worker, with one thread: pieces are done side by side."""
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(1)  # of this thread alone
    else:
        os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    unfit = _unfit(path, code)
    if unfit:
        raise ClusterError(f"a worker {unfit}")
    return _read(path)(first, last)


def _unfit(path: Path, code: str) -> str | None:
    """Return why this process can't do the work, or None."""
    if not path.is_file():
        return f"does not see {path.parent}. Mount it there, under the same path"
    if code != _our_code():
        return "runs another version of rfpipe or what it rests on. Install the same and restart it"
    return None


@lru_cache(maxsize=1)
def _read(path: Path) -> Work[Any]:
    """Read work; the stores that it opens stay open until this process gets other work."""
    work: Work[Any] = pickle.loads(path.read_bytes())
    return work


@cache
def _our_code() -> str:
    return fingerprint([code_digest(), versions()])


def machine_memory_mb() -> int:
    """Return the memory of this machine, or its control group's share of it, in MB."""
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # no groups, or "max"
        have = min(have, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return have // 10**6
