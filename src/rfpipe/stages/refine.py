"""Stage: the method's state after a level's images."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from rfpipe.jobs.job import Progress
from rfpipe.methods import LevelImages, Options
from rfpipe.methods.images import ScheduledImages
from rfpipe.provenance import fingerprint
from rfpipe.references.reference_images import read_floodlit
from rfpipe.stages.context import Acquisition
from rfpipe.stages.normalize import NormalizedImages, read_normalization
from rfpipe.stages.schedule import read_schedule
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.steps import displayed_by
from rfpipe.text import counted, percent
from rfpipe.transport.base import last_estimate
from rfpipe.units import RADIANCE_UNIT

_log = logging.getLogger(__name__)


def run(acquisition: Acquisition, level: int) -> Any:
    """Refine the method's state by a level's images, and write what the level changed.

    Returns the state after the level; None where it is in the storage already.
    """
    plan, storage = acquisition.plan, acquisition.storage
    planned = storage.read_manifest(level, "schedule")
    inputs_fingerprint = fingerprint(
        {
            "plan": plan.describe(),
            "refine": acquisition.refined_digests(level),
            "schedule": [planned["pattern_digest"], planned["complete"]],
            "merge": storage.read_manifest(level, "merge")["digest"],
            "normalize": storage.read_manifest(level, "normalize")["digest"],
            "code": acquisition.settings.code,
        }
    )
    if storage.current_manifest(level, "refine", inputs_fingerprint):
        return None
    previous = acquisition.state_before(level)
    state = _refined(acquisition, previous, level)
    _log_estimate(state.rows, plan.options)
    _log_forecast(level, plan.method.remaining_patterns(state), acquisition.settings)
    changed = state.to_arrays(previous)
    facts = {
        "stage": "refine",
        "method": plan.name,
        "level": level,
        "patterns": planned["patterns"],
        "units": RADIANCE_UNIT,
    }
    storage.write(
        level, "refine", inputs_fingerprint, changed.arrays, facts, state=dict(changed.attributes)
    )
    return state


def _refined(acquisition: Acquisition, previous: Any, level: int) -> Any:
    """Refine the state before a level by the level's images."""
    method, storage = acquisition.plan.method, acquisition.storage
    schedule, factors = read_schedule(storage, level), read_normalization(storage, level)
    with storage.pictures(level, "merge") as merged:
        images: LevelImages = NormalizedImages(schedule, merged, factors)
        if schedule.count == 1 and schedule.complete:  # the floodlit image has far less noise
            floodlit, variance = (image[None] for image in read_floodlit(storage))
            images = ScheduledImages(schedule, lambda *_: (floodlit, variance))
        with displayed_by(partial(Progress, unit="step", is_visible=acquisition.settings.progress)):
            return method.refine(previous, images, acquisition.resources.data_bytes)


def _log_estimate(level_rows: Sequence[Mapping[str, Any]], options: Options) -> None:
    """Log the error that a method estimated after the last of its levels, if it did."""
    last = last_estimate(level_rows)
    if last and last["level"] == level_rows[-1]["level"]:
        target = (
            "" if options.error_target is None else f", target {100 * options.error_target:.3g} %"
        )
        _log.info(
            "level %d: estimated error %s %% after %s%s", last["level"],
            percent(last["estimated_error"]), counted(last["patterns"], "pattern"), target,
        )  # fmt: skip


def _log_forecast(level: int, patterns: int | None, settings: AcquisitionSettings) -> None:
    """Log the expected number of further patterns with their check pictures, and their time."""
    if patterns:
        checks = patterns // settings.check_interval if settings.check_interval else 0
        minutes = settings.seconds_per_pattern * (patterns + checks) / 60
        _log.info("level %d: about %s, %.2g min on a rig", level,
                  counted(patterns + checks, "more picture"), minutes)  # fmt: skip
