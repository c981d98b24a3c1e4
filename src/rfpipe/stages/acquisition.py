"""The loop over the levels of an acquisition, and its stages as jobs of the workflow.

Results that are in the storage already, of the same inputs, are left as they are: an acquisition
that was stopped continues where it stopped, also if jobs of single stages have begun it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from rfpipe.errors import DamagedStageError
from rfpipe.stages import assemble, capture, merge, normalize, refine, schedule
from rfpipe.stages.context import Acquisition
from rfpipe.storage.damage import clear

_log = logging.getLogger(__name__)

LEVEL_STAGES: dict[str, Callable[[Any, int], Any]] = {
    "schedule": schedule.run,
    "capture": capture.run,
    "merge": merge.run,
    "normalize": normalize.run,
    "refine": refine.run,
}
"""Function of each stage of a level: ``run(acquisition, level)``, see `rfpipe.stages.context`.

Capture and merge take a `CaptureContext`, all others an `Acquisition`. `refine` returns the
method's state, the others return nothing.
"""


def acquire_levels(acquisition: Acquisition) -> Iterator[Acquisition]:
    """Acquire level by level until the method is done; yield the acquisition after each level.

    Each stage reads what the stages before it wrote in the storage. `acquisition` has no state: it
    is the method's at the start, or restored from the storage. The state after a level is passed on
    to the next level.
    """
    assert acquisition.state is None
    for level in count():
        _timed(acquisition, "schedule", level)
        if not acquisition.storage.read_manifest(level, "schedule")["patterns"]:
            return
        _timed(acquisition, "capture", level)
        _timed(acquisition, "merge", level)
        if level == 0:  # the merge has measured the rig's symmetry, which may change the method
            plan = acquisition.plan.for_measured_rig(acquisition.storage, is_logged=True)
            acquisition = replace(acquisition, plan=plan)
        _timed(acquisition, "normalize", level)
        state = _timed(acquisition, "refine", level)
        acquisition = replace(acquisition, state=state)
        yield acquisition


def _timed(acquisition: Acquisition, stage: str, level: int) -> Any:
    """Run a stage of a level and record its time; return the state that `refine` returns."""
    with acquisition.storage.timing(level, stage), acquisition.resources.blas_threads():
        return LEVEL_STAGES[stage](acquisition, level)


def acquire_transport(acquisition: Acquisition) -> None:
    """Acquire a transport in files; complete stages are skipped, ``transport.json`` comes last.

    The caller locks the folder. Where a stage finds an earlier result damaged, that one is made
    again, once, unless it is a capture. Other errors come from the stages; all results stay.
    """
    cleared: set[Path] = set()
    while True:
        try:
            *_, finished = acquire_levels(acquisition)
            assemble.run(finished)
        except DamagedStageError as error:
            if error.manifest in cleared or not clear(error):
                raise
            cleared.add(error.manifest)
            _log.warning("%s: runs again. %s", error.manifest, error.problem)
        else:
            return
