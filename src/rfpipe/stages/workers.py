"""What a stage may use, memory and cores, and doing its work side by side within that."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

__all__ = ["Resources", "Workers"]

Result = TypeVar("Result")

# Of the budget; the rest is Python with its libraries, and what an estimate leaves out.
_SHARE_FOR_DATA = 0.5
# Pieces of work handed out per thread: one in hand, one to go on with.
_AHEAD = 2


@dataclass(frozen=True)
class Resources:
    """What a job may use. None of it changes a result.

    Parameters
    ----------
    memory_gib : float
        Peak memory of the job in GiB, above 0.
    threads : int
        Threads to work with, at least 1.
    """

    memory_gib: float = 4.0
    threads: int = 1

    @classmethod
    def of_job(cls, snakemake: Any) -> Resources:
        """Return those of a job of the workflow, as Snakemake tells its script."""
        return cls(snakemake.resources.mem_mib / 1024, snakemake.threads)

    @property
    def data_bytes(self) -> int:
        """Bytes that the data in hand may take."""
        return int(self.memory_gib * 2**30 * _SHARE_FOR_DATA)

    def fitting(self, bytes_each: int, most: int) -> int:
        """Return how many things of a size fit, from 1 to `most`."""
        return max(1, min(most, self.data_bytes // max(1, bytes_each)))

    @contextmanager
    def workers(self, bytes_each: int) -> Iterator[Workers]:
        """Provide workers for pieces of work that need `bytes_each` while they are in hand."""
        count = self.fitting(_AHEAD * bytes_each, self.threads)
        if count == 1:
            yield Workers(None, 1)
            return
        with ThreadPoolExecutor(count) as pool:
            try:
                yield Workers(pool, _AHEAD * count)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


@dataclass(frozen=True)
class Workers:
    """Does pieces of work, several at a time.

    Parameters
    ----------
    pool : Executor or None
        None does one after the other, here.
    in_flight : int
        Pieces handed out at a time: with their results, all that is in memory.
    """

    pool: Executor | None
    in_flight: int

    def results(
        self, work: Callable[[int, int], Result], runs: Iterable[tuple[int, int]]
    ) -> Iterator[Result]:
        """Yield ``work(first, last)`` of each run, in their order."""
        if self.pool is None:
            for first, last in runs:
                yield work(first, last)
            return
        handed_out: deque[Future[Result]] = deque()
        for first, last in runs:
            if len(handed_out) == self.in_flight:
                yield handed_out.popleft().result()
            handed_out.append(self.pool.submit(work, first, last))
        while handed_out:
            yield handed_out.popleft().result()
