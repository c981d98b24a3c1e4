"""Acquisitions of a configuration as pieces of work: each whole, and what a job leaves of it."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import chdir, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any

from rfpipe.errors import InputError
from rfpipe.stages import captures, levels
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.job import message_of, stage_log
from rfpipe.stages.jobs.progress import Progress
from rfpipe.stages.jobs.settings import asked_of, simulation_of, stages_of
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan, plan_of
from rfpipe.store import StoreLock

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["Acquired", "acquire_all", "mark_outdated", "outdated"]

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
        The results' folder; workers see it, and the working folder, under the same paths.
    resources : Resources
        Where to work; of memory each acquisition has what its scene's settings say. Threads do
        one after the other.
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
    plain = settings.model_dump(mode="json")
    work = _Acquisitions(plain, results.absolute(), names, Path.cwd())
    found: dict[tuple[str, str], Acquired] = {}
    with (
        resources.workers(1, results) as workers,
        Progress("acquisitions", len(names), unit="acquisition") as progress,
    ):
        for (one,) in workers.as_done(work, [(i, i + 1) for i in range(len(names))]):
            found[one.scene, one.method] = one
            progress.advance(1)
    return [found[name] for name in names]


def outdated(settings: Config, results: Path) -> list[tuple[str, str]]:
    """Return the finished acquisitions, as scene and method, that were asked for something else.

    What they were asked for lies beside them, whoever made them: those of earlier versions, which
    don't tell, are left out.
    """
    simulated = settings.capture.rig == "simulated"
    found: list[tuple[str, str]] = []
    for scene, method in settings.acquisitions:
        folder = AcquisitionFolder(results / scene / method)
        if not (folder.path / "transport.json").exists() or not folder.asked.exists():
            continue
        now = asked_of(
            plan_of(settings, scene, method),
            stages_of(settings, scene, method),
            simulation_of(settings, scene) if simulated else None,
        )
        if folder.asked.read_bytes() != now.encode():
            found.append((scene, method))
    return found


def mark_outdated(settings: Config, results: Path) -> None:
    """Give the manifests of `outdated` a time before all others, by which Snakemake knows them.

    It knows what its own jobs were asked for, but not what `acquire_all` was, nor anything of
    results that were moved without its folder. What a rig has captured is left as it is: that is
    captured again for what Snakemake itself knows to have changed, and can be kept by its --touch.
    """
    if settings.capture.rig != "simulated":
        return
    for scene, method in outdated(settings, results):
        with suppress(OSError):  # of results that can only be read, all stay as they are
            os.utime(results / scene / method / "transport.json", (0, 0))


@dataclass(frozen=True)
class _Acquisitions:
    """Does acquisitions; any process may, one at a time."""

    settings: dict[str, Any]
    results: Path
    names: tuple[tuple[str, str], ...]
    home: Path  # to which settings' files are relative, wherever the worker was started

    def __call__(self, first: int, last: int) -> list[Acquired]:
        """Do some of them, or what is missing of them."""
        with _acquiring, chdir(self.home):
            return [self._acquire(*name) for name in self.names[first:last]]

    @cached_property
    def _settings(self) -> Config:
        """The settings, checked once in a process."""
        from rfpipe.config import Config

        return Config(**self.settings)

    def _acquire(self, scene: str, method: str) -> Acquired:
        folder = self.results / scene / method
        began = perf_counter()
        error = None
        try:
            with StoreLock(folder):  # the log is that of whoever works on it
                pass
            before = _times_of_stages(folder)
            self._logged(scene, method, folder)
            if _times_of_stages(folder) != before:  # else there was nothing to do
                times = folder / "acquire.benchmark.tsv"
                times.write_text(f"s\n{perf_counter() - began:.4f}\n", encoding="ascii")
        except Exception as failure:  # also a scene's or method's own bug is that acquisition's
            error = message_of(failure)
        return Acquired(scene, method, perf_counter() - began, error)

    def _logged(self, scene: str, method: str, folder: Path) -> None:
        with _log_of(folder / "acquire.log"):
            try:
                _acquire(self._settings, scene, method, folder)
            except Exception as failure:
                _log.exception("%s", message_of(failure))
                raise


def _acquire(settings: Config, scene: str, method: str, folder: Path) -> None:
    """Do what a job of the workflow does, see workflow/scripts/acquire_simulated.py."""
    resources = Resources(settings.of_scene(scene).resources.memory_gib)
    plan, stages = plan_of(settings, scene, method), stages_of(settings, scene, method)
    simulation = simulation_of(settings, scene)
    levels.run(
        Plan(**plan),
        AcquisitionFolder(folder, believing=True),
        scene,
        captures.by_simulation(**simulation, threads=resources.threads),
        **stages,
        resources=resources,
        asked=asked_of(plan, stages, simulation),
    )


def _times_of_stages(folder: Path) -> dict[Path, int]:
    """Return what is another one when any stage of an acquisition has done some work."""
    return {path: path.stat().st_mtime_ns for path in folder.glob("L*/*.benchmark.tsv")}


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
