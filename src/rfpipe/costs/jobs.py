"""What the acquisitions of a run are likely to take."""

from __future__ import annotations

from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from rfpipe.costs.model import Laws, Quantity, fit_laws
from rfpipe.costs.records import Record, Subject, read_shipped, records_in
from rfpipe.stages.plan import Plan, plan_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["JobCosts"]

# Acquisitions of a run to learn from.
_MOST_NEARBY = 200


class JobCosts:
    """Memory and processor time of a run's acquisitions.

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

    def predict(self, quantity: Quantity, job: str, scene: str, name: str) -> float | None:
        """Return what a job is likely to take itself; see `Laws.predict`."""
        return self._laws.predict(quantity, job, self._subject(scene, name))

    @property
    def _nearby(self) -> list[Record]:
        return records_in(self._results, self._settings.scenes, _MOST_NEARBY)

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
