"""What a stage may use, memory and cores, and doing its work side by side within that."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

__all__ = ["Resources", "Workers"]

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)
Work = Callable[[int, int], Result]

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
    cluster : str or None
        Address of a dask scheduler, such as ``tcp://host:8786``, whose workers then do what they
        can in the threads' place.
    """

    memory_gib: float = 4.0
    threads: int = 1
    cluster: str | None = None

    @classmethod
    def of_job(cls, snakemake: Any) -> Resources:
        """Return those of a job of the workflow, as Snakemake tells its script."""
        resources = snakemake.resources
        memory_gib = min(resources.mem_mib / 1024, float(resources.memory_gib))
        return cls(memory_gib, snakemake.threads, resources.get("dask") or None)

    @property
    def data_bytes(self) -> int:
        """Bytes that the data in hand may take."""
        return int(self.memory_gib * 2**30 * _SHARE_FOR_DATA)

    @property
    def here(self) -> Resources:
        """The same without the cluster."""
        return replace(self, cluster=None)

    def fitting(self, bytes_each: int, most: int) -> int:
        """Return how many things of a size fit, from 1 to `most`."""
        return max(1, min(most, self.data_bytes // max(1, bytes_each)))

    @contextmanager
    def workers(self, bytes_each: int) -> Iterator[Workers]:
        """Provide workers for pieces of work that need `bytes_each` while they are in hand.

        Raises
        ------
        ClusterError
            When the cluster doesn't answer, has no workers, or runs another rfpipe.
        """
        if self.cluster is not None:
            from rfpipe.stages.jobs.cluster import connected

            with connected(self.cluster) as cluster:
                in_flight = self.fitting(bytes_each, _AHEAD * cluster.threads)
                yield Workers(cluster.hand_out, in_flight)
            return
        count = self.fitting(_AHEAD * bytes_each, self.threads)
        if count == 1:
            yield Workers(None, 1)
            return
        with ThreadPoolExecutor(count) as pool:
            try:
                yield Workers(
                    lambda work: lambda first, last: pool.submit(work, first, last),
                    _AHEAD * count,
                )
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


class Promise(Protocol[Result_co]):
    """A result to come."""

    def result(self) -> Result_co:
        """Wait for the result, or raise what the work raised."""


@dataclass(frozen=True)
class Workers:
    """Does pieces of work, several at a time.

    Parameters
    ----------
    hand_out : callable or None
        Takes the work and returns what hands out a piece of it, ``(first, last)``, and promises
        the result. None does one piece after the other, here.
    in_flight : int
        Pieces handed out at a time: with their results, all that is in memory.
    """

    hand_out: Callable[[Work[Any]], Callable[[int, int], Promise[Any]]] | None
    in_flight: int

    def results(self, work: Work[Result], runs: Iterable[tuple[int, int]]) -> Iterator[Result]:
        """Yield ``work(first, last)`` of each run, in their order."""
        if self.hand_out is None:
            for first, last in runs:
                yield work(first, last)
            return
        promise = self.hand_out(work)
        handed_out: deque[Promise[Result]] = deque()
        for first, last in runs:
            if len(handed_out) == self.in_flight:
                yield handed_out.popleft().result()
            handed_out.append(promise(first, last))
        while handed_out:
            yield handed_out.popleft().result()
