"""What a stage may use, memory and cores, and doing its work side by side within that."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from rfpipe.config.addresses import THREADS, check_workers
from rfpipe.errors import ConfigError

__all__ = ["VARIABLE", "Resources", "Workers", "machine_memory_mb", "workers_from_environment"]

VARIABLE = "RFPIPE_WORKERS"
"""Environment variable that says where to work, whatever the settings say."""

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)
Work = Callable[[int, int], Result]

# Of the budget; the rest is Python with its libraries, and what an estimate leaves out.
_SHARE_FOR_DATA = 0.5
# Pieces of work handed out per thread: one in hand, one to go on with.
_AHEAD = 2
# What a control group leaves to its processes.
_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


@dataclass(frozen=True)
class Resources:
    """What a job may use. None of it changes a result.

    Parameters
    ----------
    memory_gib : float
        Peak memory of the job in GiB, above 0.
    threads : int
        Threads to work with, at least 1.
    where : str
        "threads" of this process, or the address of a dask scheduler, such as
        ``tls://host:8786``, whose workers then do what they can.
    """

    memory_gib: float = 4.0
    threads: int = 1
    where: str = THREADS

    @classmethod
    def of_job(cls, snakemake: Any) -> Resources:
        """Return those of a job of the workflow, as Snakemake tells its script.

        Raises
        ------
        ConfigError
            When the environment variable `VARIABLE` says where to work, but no place.
        """
        resources = snakemake.resources
        memory_gib = resources.mem_mib / 1024
        if "memory_gib" in resources.keys():  # noqa: SIM118 - Snakemake's resources are no mapping
            memory_gib = min(memory_gib, float(resources.memory_gib))
        where = workers_from_environment() or resources.get("workers") or THREADS
        return cls(memory_gib, snakemake.threads, where)

    @property
    def data_bytes(self) -> int:
        """Bytes that the data in hand may take."""
        return int(self.memory_gib * 2**30 * _SHARE_FOR_DATA)

    @property
    def here(self) -> Resources:
        """The same in this process."""
        return replace(self, where=THREADS)

    def fitting(self, bytes_each: int, most: int) -> int:
        """Return how many things of a size fit, from 1 to `most`."""
        return max(1, min(most, self.data_bytes // max(1, bytes_each)))

    @contextmanager
    def workers(self, bytes_each: int, folder: Path) -> Iterator[Workers]:
        """Provide workers for pieces of work that need `bytes_each` while they are in hand.

        Parameters
        ----------
        bytes_each : int
        folder : Path
            One that the work reads from or writes to. Workers that don't see it are refused.

        Raises
        ------
        ClusterError
            When the cluster doesn't answer, has no workers, runs another rfpipe, or doesn't see
            the folder.
        """
        if self.where != THREADS:
            from rfpipe.stages.jobs.cluster import connected

            with connected(self.where, folder) as cluster:
                in_flight = self.fitting(bytes_each, _AHEAD * cluster.threads)
                yield Workers(cluster.hand_out, in_flight)
            return
        count = self.fitting(_AHEAD * bytes_each, self.threads)
        if count == 1:
            yield Workers(None, 1)
        else:
            with _threads(count) as hand_out:
                yield Workers(hand_out, _AHEAD * count)


@contextmanager
def _threads(count: int) -> Iterator[HandOut]:
    with ThreadPoolExecutor(count) as pool:
        try:
            yield lambda work: lambda first, last: pool.submit(work, first, last)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def machine_memory_mb() -> int:
    """Return the memory of this machine, or that its control group leaves to us, in MB."""
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # no groups, or "max"
        have = min(have, int(_GROUP_LIMIT.read_text()))
    return have // 10**6


def workers_from_environment() -> str | None:
    """Return where the environment says to work, None where it says nothing.

    Raises
    ------
    ConfigError
        When that is no place.
    """
    where = os.environ.get(VARIABLE, "").strip()
    if not where:
        return None
    try:
        check_workers(where)
    except ValueError as error:
        raise ConfigError(f"environment variable {VARIABLE} is {where!r}; it {error}") from None
    return where


class Promise(Protocol[Result_co]):
    """A result to come."""

    def result(self) -> Result_co:
        """Wait for the result, or raise what the work raised."""


HandOut = Callable[[Work[Any]], Callable[[int, int], Promise[Any]]]


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

    hand_out: HandOut | None
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
