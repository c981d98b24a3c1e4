"""A whole acquisition, level after level, in one process: on files, or in memory.

On files each stage leaves its store, manifest, log and time as if it were a job. What stands there
already, made from the same things, is left as it is: an acquisition that was stopped goes on where
it stopped, also where jobs of single stages have begun it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rfpipe.errors import DamagedStageError
from rfpipe.stages import assemble, merge, normalize, refine, schedule
from rfpipe.stages.folder import AcquisitionFolder, clear
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan

Settings = Mapping[str, Mapping[str, Any]]

_log = logging.getLogger(__name__)


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    stages: Settings,
    resources: Resources,
) -> None:
    """Acquire a scene by a method, or what is missing of it; ``transport.json`` comes last.

    Parameters
    ----------
    folder : AcquisitionFolder
        Locked by the caller.
    capture : callable
        See `rfpipe.stages.captures`.
    stages : mapping
        Settings of each stage by its name: keyword arguments, as plain data.

    Raises
    ------
    RfpipeError
        As the stages; what is done is kept. What a stage finds damaged of those before it is made
        anew, once, captures apart.
    """
    cleared: set[Path] = set()
    while True:
        try:
            run_levels(plan, folder, capture, stages, resources)
            assemble.run(plan, folder, **stages["assemble"])
        except DamagedStageError as error:
            if error.manifest in cleared or not clear(error):
                raise
            cleared.add(error.manifest)
            _log.warning("%s: made anew. %s", error.manifest, str(error).partition(". To do")[0])
        else:
            return


def run_levels(
    plan: Plan,
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    stages: Settings,
    resources: Resources,
) -> None:
    """Take an acquisition through all stages of all levels, whatever stands there; see `run`."""
    work: dict[str, Callable[..., None]] = {
        "schedule": partial(schedule.run, plan),
        "capture": partial(capture, resources=resources.here),
        "merge": partial(merge.run, resources=resources),
        "normalize": partial(normalize.run, plan),
        "refine": partial(refine.run, plan, resources=resources),
    }
    for level in folder.levels():
        for name, stage in work.items():
            with folder.doing(level, name):
                stage(folder, level, **stages[name])
