"""A whole acquisition on files: the workflow's stages, level after level, in one process.

Each stage leaves its store, manifest, log and time as if it were a job. What stands there already,
made from the same things, is left as it is: an acquisition that was stopped goes on where it
stopped, also where jobs of single stages have begun it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

from rfpipe.errors import DamagedStageError
from rfpipe.stages import assemble, merge, normalize, refine, schedule
from rfpipe.stages.capturing.sensors import read_sensor
from rfpipe.stages.folder import AcquisitionFolder, clear
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan

__all__ = ["STAGES_LOG", "run"]

STAGES_LOG = "stages.log"
"""Beside the transport: the stages that were done here, of which Snakemake keeps no records.

Where it is newer than level 0's schedule, Snakemake does all stages again; no light is taken again.
"""

_log = logging.getLogger(__name__)


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    stages: Mapping[str, Mapping[str, Any]],
    resources: Resources,
) -> None:
    """Acquire a scene by a method, or what is missing of it; ``transport.json`` comes last.

    Parameters
    ----------
    plan : Plan
    folder : AcquisitionFolder
        Locked by the caller.
    capture : callable
        See `rfpipe.stages.captures`.
    stages : mapping
        Settings of each stage by its name: keyword arguments, as plain data.
    resources : Resources

    Raises
    ------
    RfpipeError
        As the stages; what is done is kept. What a stage finds damaged of those before it is made
        anew, once, captures apart.
    """
    cleared: set[Path] = set()
    while True:
        try:
            for manifest, work in _work(plan, folder, capture, resources):
                _do(manifest, partial(work, **stages[manifest.stem]))
            assemble.run(plan, folder, **stages["assemble"])
        except DamagedStageError as error:
            if error.manifest in cleared or not clear(error):
                raise
            cleared.add(error.manifest)
            _log.warning("%s: made anew. %s", error.manifest, str(error).partition(". To do")[0])
        else:
            return


def _work(
    plan: Plan, folder: AcquisitionFolder, capture: Callable[..., None], resources: Resources
) -> Iterator[tuple[Path, Callable[..., None]]]:
    """Yield the manifest of each stage, and its function of the stage's settings."""

    def merged(level: int, **settings: Any) -> None:
        merge.run(read_sensor(folder), folder, level, **settings, resources=resources)

    for level in folder.levels():
        at_level: dict[str, Callable[..., None]] = {
            "schedule": partial(schedule.run, plan, folder, level),
            "capture": partial(capture, folder, level, resources=resources.here),
            "merge": partial(merged, level),
            "normalize": partial(normalize.run, plan, folder, level),
            "refine": partial(refine.run, plan, folder, level, resources=resources),
        }
        yield from ((folder.manifest(level, name), work) for name, work in at_level.items())


def _do(manifest: Path, work: Callable[[], None]) -> None:
    """Do a stage's work with its log beside its manifest; keep the seconds that it took, if any."""
    before, began = manifest.exists() and manifest.stat().st_mtime_ns, perf_counter()
    with stage_log(manifest.with_suffix(".log")):
        work()
    if manifest.stat().st_mtime_ns != before:
        times = manifest.with_suffix(".benchmark.tsv")
        times.write_text(f"s\n{perf_counter() - began:.4f}\n", encoding="ascii")
        with (manifest.parents[1] / STAGES_LOG).open("a", encoding="utf-8") as done:
            done.write(f"{manifest.parent.name}/{manifest.stem}\n")
