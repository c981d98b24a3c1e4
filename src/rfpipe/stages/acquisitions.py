"""Acquisitions of a configuration as pieces of work: each whole, and what a job leaves of it."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any

from rfpipe.errors import InputError, RfpipeError
from rfpipe.stages import captures, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.progress import Progress
from rfpipe.stages.jobs.settings import stages_of
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan, plan_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["Acquired", "acquire_all"]

_log = logging.getLogger("rfpipe")

# Logs and warnings are a process's: one acquisition at a time has them.
_acquiring = Lock()


@dataclass(frozen=True)
class Acquired:
    """What became of an acquisition.

    Attributes
    ----------
    scene, method : str
    seconds : float
        Wall time, where it was done.
    error : str or None
        Why it failed; what was done of it is kept.
    """

    scene: str
    method: str
    seconds: float
    error: str | None = None


def acquire_all(
    settings: Config,
    results: Path,
    resources: Resources,
    chosen: Sequence[tuple[str, str]] | None = None,
) -> list[Acquired]:
    """Acquire simulated scenes, or what is missing of them, several at a time.

    Each leaves ``{scene}/{method}/transport.json`` with all that lies beside it, byte for byte what
    a job of the workflow leaves. One that was cut off, with its worker or with all of this, goes on
    where it stopped.

    Parameters
    ----------
    settings : Config
    results : Path
        The results' folder; workers see it under the same path.
    resources : Resources
        Of each of the acquisitions the memory. Threads do one after the other.
    chosen : sequence of (str, str), optional
        Scenes and methods; by default all of the settings.

    Returns
    -------
    list of Acquired
        One an acquisition, in their order: one that fails doesn't end the others.

    Raises
    ------
    InputError
        When the settings are of a real rig, whose captures are taken where it is.
    ClusterError
        As `Resources.workers`.
    """
    if settings.capture.rig != "simulated":
        raise InputError(
            f"capture.rig is {settings.capture.rig}: its pictures are taken where the rig is, one "
            "acquisition after the other; run the workflow there ('rfpipe run')"
        )
    names = tuple(settings.acquisitions if chosen is None else chosen)
    work = _Acquisitions(settings.model_dump(mode="json"), results.absolute(), names, resources)
    found: list[Acquired] = []
    with (
        resources.workers(1, results) as workers,
        Progress("acquisitions", len(names), unit="acquisition") as progress,
    ):
        for one in workers.results(work, [(i, i + 1) for i in range(len(names))]):
            found += one
            progress.advance(1)
    return found


@dataclass(frozen=True)
class _Acquisitions:
    """Does acquisitions; any process may, one at a time."""

    settings: dict[str, Any]
    results: Path
    names: tuple[tuple[str, str], ...]
    resources: Resources

    def __call__(self, first: int, last: int) -> list[Acquired]:
        """Do some of them, or what is missing of them."""
        with _acquiring:
            return [self._acquire(*name) for name in self.names[first:last]]

    def _acquire(self, scene: str, method: str) -> Acquired:
        from rfpipe.config import Config

        settings = Config(**self.settings)
        folder = self.results / scene / method
        began = perf_counter()
        error = None
        with _log_of(folder / "acquire.log"):
            try:
                _acquire(settings, scene, method, folder, Resources(self.resources.memory_gib))
            except RfpipeError as failure:
                error = str(failure)
                _log.exception("%s", failure)
        return Acquired(scene, method, perf_counter() - began, error)


def _acquire(settings: Config, scene: str, method: str, folder: Path, resources: Resources) -> None:
    """Do what a job of the workflow does, see workflow/scripts/acquire_simulated.py."""
    about = settings.scenes[scene].model_dump(mode="json", exclude={"methods", "sweep"})
    camera = settings.camera.model_dump(mode="json") if settings.camera else None
    rig = {"seed": settings.seed, "seconds_per_pattern": settings.capture.seconds_per_pattern}
    levels.run(
        Plan(**plan_of(settings, scene, method)),
        AcquisitionFolder(folder, believing=True),
        scene,
        captures.by_simulation(about, camera, resources.threads, **rig),
        **stages_of(settings, scene, method),
        resources=resources,
    )


@contextmanager
def _log_of(path: Path) -> Iterator[None]:
    """Log to an acquisition's file alone, and leave the log as it was."""
    level, handlers, propagates = _log.level, _log.handlers, _log.propagate
    _log.setLevel(logging.INFO)
    _log.handlers, _log.propagate = [], False
    path.unlink(missing_ok=True)
    try:
        with stage_log(path):
            yield
    finally:
        for handler in _log.handlers:
            handler.close()
        _log.setLevel(level)
        _log.handlers, _log.propagate = handlers, propagates
