"""What a stage may use, memory and cores, and its work side by side within that."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from rfpipe.config.addresses import THREADS, check_workers
from rfpipe.errors import ConfigError

_VARIABLE = "RFPIPE_WORKERS"

Result = TypeVar("Result")
Work = Callable[[int, int], Result]
"""``work(first, last)`` does a piece; any thread, or process of a cluster, may call it."""

# Half of the budget is for Python with its libraries, and what an estimate leaves out.
_SHARE_FOR_DATA = 0.5
# Pieces per thread: one in hand, one to go on with.
_AHEAD = 2


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

        Raises
        ------
        ConfigError
            When RFPIPE_WORKERS is no place to work.
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

        `folder` is one that the work reads or writes; a cluster's workers must see it.

        Raises
        ------
        ClusterError
            When the cluster doesn't answer, or isn't fit for the work.
        """
        if self.where != THREADS:
            from rfpipe.stages.jobs.cluster import connected

            with connected(self.where, folder) as (hand_out, threads):
                yield Workers(hand_out, self.fitting(bytes_each, _AHEAD * threads))
            return
        count = self.fitting(_AHEAD * bytes_each, self.threads)
        if count == 1:
            yield Workers(None, 1)
            return
        with ThreadPoolExecutor(count) as pool:
            try:
                yield Workers(
                    lambda work: lambda first, last: pool.submit(work, first, last), _AHEAD * count
                )
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


@dataclass(frozen=True)
class Workers:
    """Does pieces of work, several at a time.

    Parameters
    ----------
    hand_out : callable or None
        None does one piece after the other, here.
    in_flight : int
        Pieces handed out at a time: with their results, all that is in memory.
    """

    hand_out: HandOut | None
    in_flight: int

    def results(self, work: Work[Result], runs: Iterable[tuple[int, int]]) -> Iterator[Result]:
        """Yield ``work(first, last)`` of each run, in their order."""
        if self.hand_out is None:
            yield from (work(first, last) for first, last in runs)
            return
        ask = self.hand_out(work)
        handed_out: deque[Any] = deque()
        for first, last in runs:
            if len(handed_out) == self.in_flight:
                yield handed_out.popleft().result()
            handed_out.append(ask(first, last))
        while handed_out:
            yield handed_out.popleft().result()


def machine_memory_mb() -> int:
    """Return the memory of this machine, or its control group's share of it, in MB."""
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # no groups, or "max"
        have = min(have, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return have // 10**6
