"""Stage: what a level's images tell about the transport, and what is left to ask."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from rfpipe.jobs.job import Progress
from rfpipe.jobs.workers import Resources
from rfpipe.methods import Pack
from rfpipe.methods.base import LevelImages
from rfpipe.methods.images import ImagesAs
from rfpipe.provenance import fingerprint
from rfpipe.references.reference_images import read_floodlit
from rfpipe.stages.normalize import NormalizedImages, read_normalization
from rfpipe.stages.plan import Plan, packed
from rfpipe.stages.schedule import read_schedule
from rfpipe.steps import displayed_by
from rfpipe.storage.files import AcquisitionFolder
from rfpipe.text import counted, percent
from rfpipe.transport.base import last_estimate
from rfpipe.units import RADIANCE_UNIT

_log = logging.getLogger(__name__)


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    level: int,
    code: str,
    resources: Resources | None = None,
    *,
    progress: bool = True,
) -> None:
    """Refine the method's state by a level's images; write what the level added.

    Levels behind it that have no patterns to show are passed on the way: what they add is written
    with it, and its manifest tells which level is ``next``, null where there is none.
    """
    plan.settle(folder)
    planned = folder.read_manifest(level, "schedule")
    made_from = fingerprint(
        {
            "plan": plan.describe(),
            "refine": folder.refined_above(level),
            "schedule": [planned["shown"], planned["complete"]],
            "merge": folder.read_manifest(level, "merge")["digest"],
            "normalize": folder.read_manifest(level, "normalize")["digest"],
            "code": code,
        }
    )
    if folder.standing(level, "refine", made_from):
        return
    method = plan.method
    state = plan.state_before(folder, level)
    schedule, factors = read_schedule(folder, level), read_normalization(folder, level)
    with folder.frames(level, "merge") as merged:
        images: LevelImages = NormalizedImages(schedule, merged, factors)
        if schedule.count == 1 and schedule.complete:  # the references' pattern, in far less noise
            floodlit, variance = (image[None] for image in read_floodlit(folder))
            images = ImagesAs(schedule, lambda *_: (floodlit, variance))
        with displayed_by(partial(Progress, unit="step", shown=progress)), _warnings() as warnings:
            state = method.refine(state, images, (resources or Resources()).data_bytes)
    log_estimate(state.rows, plan.options)
    # in memory the state itself is carried on
    pack = method.pack if folder.is_kept else lambda _: Pack({}, {})
    packs, following = [pack(state)], level + 1
    while following < plan.n_levels and not method.asks(state):
        nothing = NormalizedImages(method.schedule(state), None, factors)
        state = method.refine(state, nothing)
        packs.append(pack(state))
        following += 1
    arrays, states = packed(packs)
    facts = {
        "stage": "refine",
        "method": plan.name,
        "level": level,
        "next": following if following < plan.n_levels else None,
        "patterns": planned["patterns"],
        "units": RADIANCE_UNIT,
        # for the end of the run, such as why a method ended above its target
        **({"warnings": warnings} if warnings else {}),
    }
    folder.write(level, "refine", made_from, arrays, facts, states=states)
    plan.carry(facts["next"], state)


@contextmanager
def _warnings() -> Iterator[list[str]]:
    """Collect the warnings that a method logs meanwhile."""

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    messages = list[str]()
    collector, logger = Collector(logging.WARNING), logging.getLogger("rfpipe.methods")
    logger.addHandler(collector)
    try:
        yield messages
    finally:
        logger.removeHandler(collector)


def log_estimate(level_rows: Sequence[Mapping[str, Any]], options: object) -> None:
    """Log the error that a method estimated after the last of its levels, if it did."""
    last = last_estimate(level_rows)
    if last and last["level"] == level_rows[-1]["level"]:
        target_error = getattr(options, "target_error", None)
        asked = "" if target_error is None else f", {100 * target_error:.3g} % asked for"
        _log.info(
            "level %d: estimated error %s %% after %s%s", last["level"],
            percent(last["estimated_error"]), counted(last["patterns"], "pattern"), asked,
        )  # fmt: skip
