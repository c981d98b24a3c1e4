"""What the jobs of a run ask a scheduler for."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache, cached_property
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from rfpipe.costs.model import Laws, Quantity, fit_laws
from rfpipe.costs.records import Record, Subject, Usage, read_shipped, records_in, usage_in
from rfpipe.stages.capturing.forecast import Forecast, forecast_of
from rfpipe.stages.plan import Plan, plan_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["JobCosts", "machine_memory_mb"]

# Of what is predicted: memory that runs out ends a job, memory asked for in vain only waits.
_MEMORY_MARGIN = 1.3
# A job of a cluster starts Snakemake, by Slurm's plugin twice, which stays beside the script.
_SNAKEMAKE_MB = 300
# Another machine, a file system over the network, neighbours: time that a job doesn't take is free.
_TIME_MARGIN = 4.0
_LEAST_MINUTES = 10
# Each attempt after one that failed asks for so much more.
_MORE_MEMORY, _MORE_TIME = 1.5, 2

_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")

# Acquisitions of a run to learn from.
_MOST_NEARBY, _MOST_LEVELS = 200, 50


def machine_memory_mb() -> int:
    """Return the memory of this machine, or that its control group leaves to us, in MB."""
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # no groups, or "max"
        have = min(have, int(_GROUP_LIMIT.read_text()))
    return have // 10**6


class JobCosts:
    """Memory, time and disk of a run's jobs, for Snakemake's ``resources``.

    Parameters
    ----------
    settings : Config
    results : Path
        Folder of the run's results: jobs that have run tell of those that will.
    """

    def __init__(self, settings: Config, results: Path) -> None:
        self._settings = settings
        self._results = results
        self._subject = cache(self._find_subject)
        self._forecast = cache(self._find_forecast)
        self._levels: dict[tuple[str, bool, int], list[tuple[float, Usage]]] = {}

    def predict(self, quantity: Quantity, job: str, scene: str, name: str) -> float | None:
        """Return what a job is likely to take itself; see `Laws.predict`."""
        return self._laws.predict(quantity, job, self._subject(scene, name))

    def memory_mb(
        self, job: str, scene: str, name: str, attempt: int = 1, *, level: int | None = None
    ) -> int:
        """Return the memory to ask for in MB, more with each attempt.

        The setting ``resources.memory_gib`` for a job of which nothing is known. For a job of one
        level what such jobs of other scenes took, else what the whole acquisition would.
        """
        predicted = self._of_level("memory_mb", scene, name, level)
        if predicted is None:
            predicted = self.predict("memory_mb", job, scene, name)
        return self._memory_to_ask(predicted, attempt, self._settings.of_scene(scene))

    def memory_of_log(self, log: Path, attempt: int = 1) -> int:
        """Return the memory to ask for in MB, for a job that has run before, by its log.

        The setting ``resources.memory_gib`` for one that hasn't, or that was killed.
        """
        took = usage_in(log)
        return self._memory_to_ask(took and took[0], attempt, self._settings)

    def _memory_to_ask(self, predicted: float | None, attempt: int, settings: Config) -> int:
        if predicted is None:
            asked = settings.resources.memory_gib * 2**30 / 1e6
        else:
            asked = _MEMORY_MARGIN * predicted + _SNAKEMAKE_MB
        return ceil(asked * _MORE_MEMORY ** (attempt - 1))

    def runtime(
        self, job: str, scene: str, name: str, attempt: int = 1, *, level: int | None = None
    ) -> int:
        """Return the minutes to ask for, more with each attempt; what a rig takes is among them."""
        predicted = self._of_level("cpu_seconds", scene, name, level)
        if predicted is None:
            predicted = self.predict("cpu_seconds", job, scene, name) or 0.0
        seconds = _TIME_MARGIN * predicted
        shows = level is None and job in ("acquire", "verification")
        if shows and self._settings.capture.rig == "remote":
            seconds += 2 * self._forecast(scene, name).expected.seconds
        return int(max(_LEAST_MINUTES, ceil(seconds / 60)) * _MORE_TIME ** (attempt - 1))

    def disk_mb(self, scene: str, name: str) -> int:
        """Return what an acquisition leaves on the disk in MB, before compression."""
        return ceil(self._forecast(scene, name).expected.disk.total / 1e6)

    @property
    def _nearby(self) -> list[Record]:
        return records_in(self._results, self._settings.scenes, _MOST_NEARBY)

    def _of_level(
        self, quantity: Quantity, scene: str, name: str, level: int | None
    ) -> float | None:
        """Return the most that jobs of a level took by the same method; None where none has run."""
        if level is None:
            return None
        subject = self._subject(scene, name)
        key = subject.method, subject.views > 1, level
        if not self._levels.get(key):
            self._levels[key] = self._levels_run(*key)
        index = 0 if quantity == "memory_mb" else 1
        return max(
            (
                usage[index] * max(1.0, subject.size / size)
                for size, usage in self._levels[key]
                if subject.is_like(size)
            ),
            default=None,
        )

    def _levels_run(self, method: str, is_field: bool, level: int) -> list[tuple[float, Usage]]:
        """Return size and usage of jobs of a level that have run."""
        found: list[tuple[float, Usage]] = []
        all_of_them = self._settings.acquisitions
        for scene, name in all_of_them[:: -(-len(all_of_them) // _MOST_LEVELS)]:
            usage = usage_in(self._results / scene / name / f"level_{level:02d}.log")
            if usage is not None:
                subject = self._subject(scene, name)
                if (subject.method, subject.views > 1) == (method, is_field):
                    found.append((subject.size, usage))
        return found

    @cached_property
    def _laws(self) -> Laws:
        return fit_laws(read_shipped(), self._nearby)

    def _find_subject(self, scene: str, name: str) -> Subject:
        plan = Plan(**plan_of(self._settings, scene, name))
        return Subject.of(
            plan.method.name,
            plan.camera.size,
            plan.channels,
            plan.projector.views,
            self._settings.scenes[scene].simulation_bytes / 1e6,
        )

    def _find_forecast(self, scene: str, name: str) -> Forecast:
        from rfpipe.photometry import sensor_from_config

        return forecast_of(self._settings, sensor_from_config(self._settings.camera), scene, name)
