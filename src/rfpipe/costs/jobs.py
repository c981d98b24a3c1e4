"""What the jobs of a run ask a scheduler for."""

from __future__ import annotations

from functools import cache, cached_property
from math import ceil, prod
from pathlib import Path
from typing import TYPE_CHECKING

from rfpipe.costs.model import Laws, Quantity, fit_laws
from rfpipe.costs.records import read_shipped, records_in
from rfpipe.stages.capturing.forecast import Forecast, forecast_of
from rfpipe.stages.plan import Plan, plan_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["JobCosts"]

# Of what is predicted: memory that runs out ends a job, memory asked for in vain only waits.
_MEMORY_MARGIN = 1.3
# A job of a cluster starts Snakemake, by Slurm's plugin twice, which stays beside the script.
_SNAKEMAKE_MB = 300
# Another machine, a file system over the network, neighbours: time that a job doesn't take is free.
_TIME_MARGIN = 4.0
_LEAST_MINUTES = 10
# Each attempt after one that failed asks for so much more.
_MORE_MEMORY, _MORE_TIME = 1.5, 2

# Acquisitions of a run to learn from.
_MOST_NEARBY = 200


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

    def predict(self, quantity: Quantity, job: str, scene: str, name: str) -> float | None:
        """Return what a job is likely to take itself; see `Laws.predict`."""
        method, samples, views = self._subject(scene, name)
        return self._laws.predict(quantity, job, method, samples, views=views)

    def memory_mb(self, job: str, scene: str, name: str, attempt: int = 1) -> int:
        """Return the memory to ask for in MB, more with each attempt.

        The setting ``resources.memory_gib`` for a job of which nothing is known.
        """
        predicted = self.predict("memory_mb", job, scene, name)
        if predicted is None:
            asked = self._settings.resources.memory_gib * 2**30 / 1e6
        else:
            asked = _MEMORY_MARGIN * predicted + _SNAKEMAKE_MB
        return ceil(asked * _MORE_MEMORY ** (attempt - 1))

    def runtime(self, job: str, scene: str, name: str, attempt: int = 1) -> int:
        """Return the minutes to ask for, more with each attempt; what a rig takes is among them."""
        seconds = _TIME_MARGIN * (self.predict("cpu_seconds", job, scene, name) or 0.0)
        if self._settings.capture.rig == "remote" and job in ("acquire", "verification"):
            seconds += 2 * self._forecast(scene, name).expected.seconds
        return int(max(_LEAST_MINUTES, ceil(seconds / 60)) * _MORE_TIME ** (attempt - 1))

    def disk_mb(self, scene: str, name: str) -> int:
        """Return what an acquisition leaves on the disk in MB, before compression."""
        return ceil(self._forecast(scene, name).expected.disk.total / 1e6)

    @cached_property
    def _laws(self) -> Laws:
        return fit_laws(read_shipped(), records_in(self._results, _MOST_NEARBY))

    def _find_subject(self, scene: str, name: str) -> tuple[str, int, int]:
        """Return the method, the samples of a picture and the views of an acquisition."""
        plan = Plan(**plan_of(self._settings, scene, name))
        shape = plan.projector.shape
        views = shape[0] if len(shape) > 2 else 1
        return plan.method.name, prod(plan.camera.shape) * plan.channels, views

    def _find_forecast(self, scene: str, name: str) -> Forecast:
        from rfpipe.photometry import sensor_from_config

        return forecast_of(self._settings, sensor_from_config(self._settings.camera), scene, name)
