"""Steadiness of a rig: looks at a pattern and its complement, in a step and around the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.bench import Bench, camera_model
from rfpipe.calibration.verdicts import Findings, Standing, Verdict
from rfpipe.provenance import generator
from rfpipe.rigs.diagnosis import faults_of
from rfpipe.rigs.faults import CALIBRATION, Fault
from rfpipe.rigs.looks import (
    BLACK,
    COMPLEMENT,
    PATTERN,
    Look,
    References,
    common_gain,
    gains_of,
    known_exposures,
    saturated_from,
    thinned,
)

_SERIES = (BLACK, BLACK, PATTERN, PATTERN, COMPLEMENT, COMPLEMENT) * 2
"""Each picture twice: the second is right where frames are late."""

_WITNESS = (PATTERN, BLACK, COMPLEMENT, PATTERN)
"""Before and after each step."""


def probe_pictures(shape: tuple[int, int], period: int) -> NDArray[np.float32]:
    """Return black, a pattern of random fields, and its complement, (3, *shape)."""
    side = min(period, max(1, min(shape) // 6))
    fields = generator(0, 2).integers(0, 2, (-(-shape[0] // side), -(-shape[1] // side)))
    pattern = np.kron(fields, np.ones((side, side)))[: shape[0], : shape[1]].astype(np.float32)
    return np.stack([np.zeros(shape, np.float32), pattern, 1 - pattern])


def take_looks(bench: Bench, pictures: Sequence[int], series: int, wait: float = 0) -> list[Look]:
    """Show pictures, `wait` seconds beyond the projector's own wait, and take a look at each."""
    shown = probe_pictures(bench.projector.shape, bench.settings.period_pixels)
    looks = []
    brackets = bench.take([shown[picture] for picture in pictures], wait=wait)
    for picture, frames in zip(pictures, brackets, strict=True):
        looks.append(Look(picture, series, time.time(), thinned(frames)))
    return looks


def probe(bench: Bench, wait: float = 0) -> tuple[list[Look], References, list[Fault]]:
    """Take a series of looks; return it, its references and the faults that it shows."""
    looks = take_looks(bench, _SERIES, 0, wait)
    references = References.of(looks, camera_model(bench.camera))
    return looks, references, faults_of(looks, references, CALIBRATION)


def measure_steadiness(bench: Bench) -> Findings:
    """Look at the pattern again and again.

    Returns
    -------
    Findings
        Arrays: ``references`` (3, E, n) and ``noise`` (E,), see `rfpipe.rigs.looks`; ``gain``
        of the lit looks, (K, E), and ``judged`` (E,), the exposures that the verdict is about.
        References are empty where the pattern is not seen.
    """
    looks, references, faults = probe(bench)
    if not references.has_light:
        nothing = {"references": np.empty(0), "gain": np.empty((0, len(references.exposures)))}
        return Findings.of("steadiness", {"is_seen": 0}, nothing)
    gains = gains_of(looks, references)
    common, _ = common_gain(gains, CALIBRATION.light)
    facts = {
        "is_seen": 1,
        "looks": len(looks),
        "lit_looks": len(gains.gain),
        "exposures_s": list(references.exposures),
        "taken_at": references.seconds,
        "range": float(np.ptp(common)),
        "noise_of_looks": float(references.noise.min()),
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
    """Return findings whose verdict names the rig's faults, in place of their consequences."""
    if not faults:
        return findings
    standing: Standing = "failed" if findings.verdict.standing == "failed" else "poor"
    text = " ".join(fault.sentence for fault in faults)
    return replace(findings, verdict=Verdict(standing, text))


def references_of(bench: Bench) -> References | None:
    """Return the references of the step steadiness; None where it is not done or saw no light."""
    steady = bench.found.get("steadiness")
    if steady is None or "references" not in steady.arrays or not steady["references"].size:
        return None
    model = camera_model(bench.camera)
    return References(
        steady["references"], steady["noise"], tuple(model.exposures), saturated_from(model),
        steady["taken_at"],
    )  # fmt: skip


def witnessed(bench: Bench, measure: Callable[[Bench], Findings]) -> Findings:
    """Measure a step between two series of looks, which show whether the rig was steady meanwhile.

    A fault that they show replaces the verdict, which would name a consequence of it. A lamp that
    drifts is added to the verdict: steps that depend on it judge it themselves.
    """
    references = references_of(bench)
    if references is None:
        return measure(bench)
    before = take_looks(bench, _WITNESS, 1)
    findings = measure(bench)
    after = take_looks(bench, _WITNESS, 2)
    faults = faults_of([*before, *after], references, CALIBRATION)
    drift = [fault.sentence for fault in faults if fault.kind == "drift"]
    findings = with_faults(findings, [fault for fault in faults if fault.kind != "drift"])
    if not drift:
        return findings
    standing, text = findings.verdict
    verdict = Verdict(standing, " ".join([text, drift[0]]))
    return replace(findings, verdict=verdict)
