"""Steadiness of a rig, measured by check pictures.

The step "steadiness" takes a series of check pictures. All later steps are enclosed by shorter
series, which are compared with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.context import StepContext, camera_model
from rfpipe.calibration.verdicts import Findings, Standing, Verdict
from rfpipe.provenance import generator
from rfpipe.rigs.check_pictures import (
    BLACK,
    COMPLEMENT,
    PATTERN,
    CheckPicture,
    References,
    common_gain,
    known_exposures,
    measured_light,
    saturated_from,
    thinned,
)
from rfpipe.rigs.diagnosis import diagnose
from rfpipe.rigs.faults import CALIBRATION, Fault

_SERIES = (BLACK, BLACK, PATTERN, PATTERN, COMPLEMENT, COMPLEMENT) * 2
"""Series of the step: each pattern twice, since the second picture is right if frames are late."""

_ENCLOSING_SERIES = (PATTERN, BLACK, COMPLEMENT, PATTERN)
"""Series before and after each later step."""


def probe_pictures(shape: tuple[int, int], period: int) -> NDArray[np.float32]:
    """Patterns of the check pictures: black, random fields, and their complement, (3, *shape)."""
    side = min(period, max(1, min(shape) // 6))
    fields = generator(0, 2).integers(0, 2, (-(-shape[0] // side), -(-shape[1] // side)))
    pattern = np.kron(fields, np.ones((side, side)))[: shape[0], : shape[1]].astype(np.float32)
    return np.stack([np.zeros(shape, np.float32), pattern, 1 - pattern])


def take_check_pictures(
    context: StepContext, kinds: Sequence[int], series: int, wait: float = 0
) -> list[CheckPicture]:
    """Take check pictures of the given kinds, in this order.

    `wait` is a time in seconds between display and exposure, in addition to the projector's wait.
    """
    displayed = probe_pictures(context.projector.shape, context.settings.period_pixels)
    pictures = []
    brackets = context.brackets((displayed[kind] for kind in kinds), len(kinds), wait=wait)
    for kind, frames in zip(kinds, brackets, strict=True):
        pictures.append(CheckPicture(kind, series, time.time(), thinned(frames)))
    return pictures


def probe(
    context: StepContext, wait: float = 0
) -> tuple[list[CheckPicture], References, list[Fault]]:
    """Take a series of check pictures; return it, its references and the faults that it shows."""
    pictures = take_check_pictures(context, _SERIES, 0, wait)
    references = References.of(pictures, camera_model(context.camera))
    return pictures, references, diagnose(pictures, references, CALIBRATION)


def measure_steadiness(context: StepContext) -> Findings:
    """Measure how much light and picture change while one pattern is shown repeatedly.

    Returns
    -------
    Findings
        Arrays: ``references`` (3, E, n) and ``noise`` (E,), see `rfpipe.rigs.check_pictures`;
        ``gain`` of the lit pictures, (K, E), and ``judged`` (E,), the exposures on which the
        verdict is based. References are empty where the pattern is not visible.
    """
    pictures, references, faults = probe(context)
    if not references.has_light:
        nothing = {"references": np.empty(0), "gain": np.empty((0, len(references.exposures)))}
        return Findings.of("steadiness", {"is_seen": 0}, nothing)
    gains = measured_light(pictures, references)
    common, _ = common_gain(gains, CALIBRATION.light)
    facts = {
        "is_seen": 1,
        "pictures": len(pictures),
        "lit_pictures": len(gains.gain),
        "exposures_s": list(references.exposures),
        "taken_at": references.seconds,
        "range": float(np.ptp(common)),
        "picture_noise": float(references.noise.min()),
        **{f"{fault.kind}_size": fault.size for fault in faults},
    }
    arrays: dict[str, NDArray[Any]] = {
        "references": references.frames,
        "noise": references.noise,
        "gain": gains.gain,
        "judged": known_exposures(gains, CALIBRATION.light),
    }
    findings = Findings.of("steadiness", facts, arrays)
    return with_faults(findings, [fault for fault in faults if fault.kind != "drift"])


def with_faults(findings: Findings, faults: Sequence[Fault]) -> Findings:
    """Replace the verdict, which describes a consequence, by the faults that caused it."""
    if not faults:
        return findings
    standing: Standing = "failed" if findings.verdict.standing == "failed" else "poor"
    text = " ".join(fault.sentence for fault in faults)
    return replace(findings, verdict=Verdict(standing, text))


def references_of(context: StepContext) -> References | None:
    """References of the step steadiness; None where it is not done or had no light."""
    steady = context.findings.get("steadiness")
    if steady is None or not steady.arrays or not steady["references"].size:
        return None
    model = camera_model(context.camera)
    return References(
        steady["references"], steady["noise"], tuple(model.exposures), saturated_from(model),
        steady["taken_at"],
    )  # fmt: skip


def with_check_pictures(
    context: StepContext, measure: Callable[[StepContext], Findings]
) -> Findings:
    """Measure a step between two series of check pictures.

    A fault that they show replaces the verdict, which would describe a consequence of the fault.
    Drift of the lamp is appended to the verdict: steps that depend on it have a limit of their own.
    """
    references = references_of(context)
    if references is None:
        return measure(context)
    before = take_check_pictures(context, _ENCLOSING_SERIES, 1)
    findings = measure(context)
    after = take_check_pictures(context, _ENCLOSING_SERIES, 2)
    faults = diagnose([*before, *after], references, CALIBRATION)
    drift = [fault.sentence for fault in faults if fault.kind == "drift"]
    findings = with_faults(findings, [fault for fault in faults if fault.kind != "drift"])
    if not drift:
        return findings
    standing, text = findings.verdict
    verdict = Verdict(standing, " ".join([text, drift[0]]))
    return replace(findings, verdict=verdict)
