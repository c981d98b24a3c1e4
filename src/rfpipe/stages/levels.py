"""A whole acquisition on files: stage after stage, level after level, in one job.

Each stage leaves its store and manifest, log and time in the level's folder, as if it ran alone. A
stage that finds its manifest, made from the same things, has nothing to do: a job that was stopped
goes on where it stopped, and one that runs again for changed settings or code does only what they
change. What a stage finds damaged of those before it is made anew, captures apart.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from rfpipe.errors import DamagedStageError
from rfpipe.photometry.normalize import Mode
from rfpipe.stages import assemble, merge, normalize, refine, schedule, symmetry
from rfpipe.stages.capture import Watching
from rfpipe.stages.capturing.moves import every_of
from rfpipe.stages.capturing.sensors import read_sensor
from rfpipe.stages.folder import SYMMETRY, AcquisitionFolder
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.stages.symmetry import NOTICED
from rfpipe.store import StoreLock, restore_header
from rfpipe.store.files import write_atomically
from rfpipe.units import NumberFormat

__all__ = ["Until", "level_after", "level_before", "run", "watching_of"]

_log = logging.getLogger(__name__)

_Work = tuple[Path, Callable[[], Any]]
"""A stage's manifest, and what does the stage."""


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    scene: str,
    capture: Callable[..., None],
    *,
    code: Mapping[str, str],
    capture_options: Mapping[str, Any],
    merge_options: Mapping[str, Any],
    normalization: Mode,
    number_format: NumberFormat,
    asymmetry: float,
    watch: Mapping[str, Any],
    resources: Resources,
    until: Until | None = None,
    asked: str | None = None,
) -> None:
    """Acquire a scene by a method, or what is missing of it; ``transport.json`` comes last.

    Parameters
    ----------
    plan : Plan
    folder : AcquisitionFolder
    scene : str
        Name, kept with the transport.
    capture : callable
        ``capture(folder, level, **options)`` is the stage `rfpipe.stages.capture.run` or
        `rfpipe.stages.hardware.run` with its rig.
    code : mapping of str to str
        As `rfpipe.stages.jobs.code.acquisition_code`.
    capture_options, merge_options : mapping
        Keyword arguments of `rfpipe.stages.capture.run` and `rfpipe.stages.merge.run`;
        ``symmetry_frames`` are taken where the method asks for them.
    normalization : {"none", "per_channel", "total_energy"}
    number_format : {"float32", "uint16", "uint8"}
        Of the stored transport.
    asymmetry : float
        Error that taking the rig for a coaxial one may make, as `rfpipe.stages.symmetry.run`.
    watch : mapping
        Keyword arguments of `watching_of`.
    resources : Resources
    until : Until, optional
        Where to end before the transport; the next job goes on from there.
    asked : str, optional
        As `rfpipe.stages.jobs.settings.asked_of`; kept beside the transport.

    Raises
    ------
    LockedError
        When another process works on the same acquisition, such as a job that outlived a
        workflow that was killed.
    RfpipeError
        As the stages; what is done is kept. `CaptureError`, too, when the method needs a coaxial
        rig and this is none.
    """
    expected = plan.method.expected_patterns(plan.camera, plan.projector, plan.options)
    if not plan.asks_symmetry:
        capture_options = {**capture_options, "symmetry_frames": 0}
    is_judged = capture_options.get("symmetry_frames", 0) > 0
    if plan.camera.shape != plan.projector.shape:
        plan.settle(plan.method.on_rig(coaxial=False))

    def refined(level: int) -> None:
        plan.carry(level + 1, refine.run(plan, folder, level, code["refine"], resources))

    def judged() -> None:
        found = symmetry.run(
            read_sensor(folder), folder,
            saturation_fraction=merge_options["saturation_fraction"], code=code["symmetry"],
            keep_raw=capture_options.get("keep_raw", True),
        )  # fmt: skip
        plan.settle(found.judge(plan.method, plan.options, asymmetry))

    stages: dict[str, Callable[[int], None]] = {
        "schedule": lambda level: schedule.run(plan, folder, level, code["schedule"]),
        "capture": lambda level: capture(
            folder, level,
            **capture_options, expected_patterns=expected, resources=resources.here,
            watching=watching_of(plan, asymmetry, **watch),
        ),
        "merge": lambda level: merge.run(
            read_sensor(folder), folder, level,
            **merge_options, code=code["merge"], resources=resources,
        ),
        "normalize": lambda level: normalize.run(
            plan, folder, level, mode=normalization, code=code["normalize"]
        ),
        "refine": refined,
    }  # fmt: skip

    def work_of(level: int) -> Iterator[_Work]:
        if level == plan.n_levels:
            if until is not None:
                return
            manifest = folder.path / "transport.json"
            yield (
                manifest,
                partial(
                    assemble.run, plan, folder, manifest, scene, number_format, code["assemble"]
                ),
            )
            return
        for name, stage in stages.items():
            yield folder.manifest(level, name), partial(stage, level)
            if is_judged and level == 0 and name == "merge":
                yield folder.manifest(0, SYMMETRY), judged

    with StoreLock(folder.path):
        level: int | None
        level, anew = 0, _Anew(folder, until)
        while level is not None and level <= plan.n_levels:
            level = anew.go_on(level, work_of(level))
        if asked is not None and until is None:
            write_atomically(folder.asked, asked.encode())


@dataclass(frozen=True)
class Until:
    """Where a job of one level ends.

    Parameters
    ----------
    level : int
    stage : {"capture", "refine"}
        After "refine", levels that ask nothing are done on the way and the next one that asks is
        scheduled, so that it is known whether there is one: see `level_after`.
    """

    level: int
    stage: Literal["capture", "refine"] = "refine"

    @classmethod
    def of_job(cls, snakemake: Any) -> Until | None:
        """Return that of a job of the workflow, as Snakemake tells its script; None for none."""
        level = snakemake.wildcards.get("level")
        return None if level is None else cls(int(level), snakemake.params.until)

    def is_at(self, folder: AcquisitionFolder, level: int, manifest: Path) -> bool:
        """Whether a stage of a level, which is done, was the last one."""
        if self.stage == "capture":
            return manifest == folder.manifest(self.level, "capture")
        return manifest.stem == "schedule" and level > self.level and _asks(folder, level)


def level_after(folder: AcquisitionFolder, level: int) -> int | None:
    """Return the level that asks something after one that is refined; None for none.

    Parameters
    ----------
    folder : AcquisitionFolder
        What a job until `level` left.
    level : int
    """
    following = level + 1
    while folder.manifest(following, "schedule").exists():
        if _asks(folder, following):
            return following
        following += 1
    return None


def level_before(folder: AcquisitionFolder, level: int) -> int | None:
    """Return the level that asked something before another; None for none."""
    asking = (above for above in reversed(range(level)) if _asks(folder, above))
    return next(asking, None)


def _asks(folder: AcquisitionFolder, level: int) -> bool:
    return bool(folder.read_manifest(level, "schedule")["patterns"])


def watching_of(plan: Plan, asymmetry: float, *, mode: str, looks: int | None) -> Watching | None:
    """Return what is looked after while an acquisition's patterns are shown.

    Where a method believes in ``T = T'``, its own patterns tell whether camera and projector are
    still aligned, and nothing else has to be shown.

    Parameters
    ----------
    plan : Plan
    asymmetry : float
    mode : {"off", "warn", "refuse"}
    looks : int or None
        Patterns from one look at the rig to the next, 0 for none. None: eight, where the method's
        patterns don't tell.
    """
    if mode == "off":
        return None
    tells = plan.method.needs_coaxial_rig
    return Watching(
        every_of(looks, tells=tells),
        NOTICED * asymmetry if tells else 0.0,
        refuse=mode == "refuse",
    )


@dataclass
class _Anew:
    """Does the stages of one level after the other; damaged ones anew, none more than once."""

    folder: AcquisitionFolder
    until: Until | None
    made: set[Path] = field(default_factory=set)

    def go_on(self, level: int, work: Iterable[_Work]) -> int | None:
        """Do a level's work, or the transport's, which comes last; return the level that follows.

        That is an earlier one where a stage found something damaged. None: all that is to be done
        is done.
        """
        for manifest, stage in work:
            with _stage(manifest):
                try:
                    stage()
                except DamagedStageError as error:
                    return self._level_of(error)
            if self.until is not None and self.until.is_at(self.folder, level, manifest):
                return None
        return level + 1

    def _level_of(self, error: DamagedStageError) -> int:
        """Return the level of a damaged stage, which will find no manifest there.

        Captures are left to the user, who knows whether the scene still stands there: of theirs,
        headers alone are restored.

        Raises
        ------
        DamagedStageError
            The given one, where nothing can be done about it.
        """
        manifest = error.manifest
        if manifest in self.made:
            raise error
        if manifest.stem == "capture":
            restored = [restore_header(store) for store in manifest.parent.glob("*.zarr")]
            if not any(restored):
                raise error
        self.made.add(manifest)
        manifest.unlink(missing_ok=True)
        _log.warning("%s: made anew. %s", manifest, str(error).partition(". To do so")[0])
        return int(manifest.parent.name.removeprefix("L"))


@contextmanager
def _stage(manifest: Path) -> Iterator[None]:
    """Keep a stage's log beside its manifest, and its seconds where it did any work."""
    store = manifest.with_suffix(".zarr")
    before, began = _stamp(store), perf_counter()
    with stage_log(manifest.with_suffix(".log")):
        yield
    if _stamp(store) != before:
        times = manifest.with_suffix(".benchmark.tsv")
        times.write_text(f"s\n{perf_counter() - began:.4f}\n", encoding="ascii")


def _stamp(store: Path) -> tuple[int, int] | None:
    """Return what changes when files of a store are written or the store is replaced."""
    try:
        status = store.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns
