"""Delay, lost and repeated frames, and changes of the light with the exposure, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from rfpipe.calibration.context import DeviceError, StepContext
from rfpipe.calibration.latency import PROBE_SECONDS, measure_latency
from rfpipe.calibration.steadiness import probe
from rfpipe.calibration.verdicts import Findings, Verdict, verdict_of
from rfpipe.errors import RfpipeError
from rfpipe.rigs.check_pictures import (
    CheckPicture,
    References,
    known_exposures,
    measured_light,
)
from rfpipe.rigs.devices import Camera
from rfpipe.rigs.diagnosis import light_range
from rfpipe.rigs.faults import CALIBRATION, SIGNIFICANCE, Fault

_UNKNOWN = Verdict("unknown", "Not known until the other fault is mended.")


def measure_synchronisation(context: StepContext) -> dict[str, Verdict]:
    """Measure how projector, camera and light keep time.

    Takes 20 brackets of a rig without delay and faults, and up to 100 of others.

    Returns
    -------
    dict of str to Verdict
        ``delay`` from drawing a picture to the camera; ``frames`` that are lost, repeated or show
        the previous picture; ``light``, which may flicker: its range in each exposure. Only
        ``delay`` where white pictures aren't brighter than black ones.

    Raises
    ------
    RfpipeError
        When a device fails.
    """
    try:
        latency = measure_latency(context)
        pictures, references, faults = probe(context, _wait(latency))
    except DeviceError as failure:
        raise failure.args[0] from None
    except RfpipeError as error:
        return {"delay": Verdict("failed", f"The delay can't be measured: {error}.")}
    delay = latency.verdict
    if not references.has_light:
        unseen = verdict_of("steadiness", {"is_seen": 0})
        return {"delay": delay, "frames": unseen, "light": unseen}
    frames = _frames_verdict(pictures, faults, context.camera)
    if faults and delay.standing != "good":  # faults of frames and light look like a delay
        delay = _UNKNOWN
    is_late = any(fault.kind == "late" for fault in faults)
    light = _UNKNOWN if is_late else _light_verdict(pictures, references, faults)
    return {"delay": delay, "frames": frames, "light": light}


def _wait(latency: Findings) -> float:
    """Seconds from display to exposure, in addition to the projector's own wait, for right frames.

    With it, the delay has no effect on the other measurements.
    """
    if latency.verdict.standing == "good":
        return 0.0
    return float(latency.facts.get("proposed_settle_seconds", PROBE_SECONDS))


def _frames_verdict(
    pictures: Sequence[CheckPicture], faults: Sequence[Fault], camera: Camera
) -> Verdict:
    """Describe lost, repeated and late frames."""
    sentences = [
        f"In {fault.size:.0%} of the changes of picture, {fault.text}."
        for fault in faults
        if fault.kind == "late"
    ]
    repeated = sum(_repeats(previous, picture) for previous, picture in pairwise(pictures))
    if repeated:
        sentences.append(
            f"{repeated} of {len(pictures)} brackets contain a frame of the bracket before, bit "
            "for bit: the camera or its driver delivers a frame again where it has no new one. "
            "Trigger single frames, or drop more frames (skip_frames of a webcam)."
        )
    statistics = getattr(camera, "statistics", {})
    lost = statistics.get("failed", 0) + statistics.get("timed_out", 0)
    if lost:
        sentences.append(
            f"{lost} of {lost + statistics['frames']} frames since the start were damaged or not "
            "delivered in time, and were taken again. Check the camera's cable and the load of its "
            "port."
        )
    if sentences:
        return Verdict("poor", " ".join(sentences))
    count = len(pictures) * len(camera.sensor.exposures)
    return Verdict("good", f"All {count} frames show their own picture; none was lost.")


def _repeats(previous: CheckPicture, picture: CheckPicture) -> bool:
    """Test whether a bracket contains a frame of the previous one, of another pattern."""
    return previous.kind != picture.kind and any(
        np.ptp(frame) > 0 and np.array_equal(frame, earlier)
        for frame in picture.frames
        for earlier in previous.frames
    )


def _light_verdict(
    pictures: Sequence[CheckPicture], references: References, faults: Sequence[Fault]
) -> Verdict:
    """Describe the changes of the light in each exposure, and faults of lamp, gain and room."""
    series = measured_light(pictures, references)
    known = known_exposures(series, CALIBRATION.light)  # saturated exposures are unknown
    rows = zip(*light_range(series), references.exposures, known, strict=True)
    parts = [
        f"of {_duration(seconds)} by {_number(size, SIGNIFICANCE * error)}"
        for size, error, seconds, is_known in rows
        if is_known
    ]
    text = ""
    if parts:
        text = f"The light changes from picture to picture, at exposures {', '.join(parts)}."
    sentences = [fault.sentence for fault in faults]
    return Verdict("poor" if faults else "good", " ".join([text, *sentences]).strip())


def _number(size: float, significant: float) -> str:
    """Format a size, or a bound where it is not significant."""
    return f"{size:.1%}" if size > significant else f"at most {max(size, significant):.1%}"


def _duration(seconds: float) -> str:
    """Format a time."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1000 * seconds:.3g} ms"
