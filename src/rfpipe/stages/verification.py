"""Stage: pictures that no method saw are taken, and compared with what the transport makes of them.

They go the way of all pictures. A stage that was stopped goes on at the picture where it stopped; a
transport that was made anew is compared with the same pictures.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import VerificationError
from rfpipe.patterns import Schedule
from rfpipe.photometry.camera import are_saturated
from rfpipe.provenance import fingerprint
from rfpipe.references.calibration_check import calibration_fault
from rfpipe.references.drift import changes_of
from rfpipe.references.reference_images import read_floodlit
from rfpipe.relighting import KINDS, reference_light, relighting_pictures
from rfpipe.stages import capture, merge
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.schedule import read_schedule, write_schedule
from rfpipe.storage.base import (
    CHECK_PICTURES,
    REFERENCE_IMAGES,
    VERIFICATION,
    VERIFICATION_MANIFEST,
    Storage,
    level_name,
)
from rfpipe.storage.files import AcquisitionFolder, write_result
from rfpipe.store import read_manifest
from rfpipe.text import counted, percent
from rfpipe.transport import Transport, open_transport
from rfpipe.transport.base import last_estimate
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    import pandas as pd

_SEED = 15  # of the pictures
_MOST_SATURATED = 0.01  # share of samples

Float = NDArray[np.float32]

_log = logging.getLogger(__name__)


class Outcome(NamedTuple):
    """Comparison of a reached error with its target.

    Attributes
    ----------
    standing : {"met", "unsure", "missed", "unknown"}
        "unsure": above the target by less than a half, within the scatter of few pictures.
    reason : str
        The numbers, and the likely cause.
    """

    standing: Literal["met", "unsure", "missed", "unknown"]
    reason: str


@dataclass(frozen=True, eq=False)
class Verification:
    """Error of a transport on pictures that were captured for this alone.

    Attributes
    ----------
    table : DataFrame
        A row a picture, relative to its light as of `picture_errors`, over the rays that the camera
        knows: ``name``; ``difference``: ``||relit - captured||``; ``noise``: the share of it that
        is expected of the captured picture's noise; ``error``: the difference without that share, 0
        where nothing but noise is seen; ``standard_error``; ``plain_error``: the error relative to
        the picture's norm, however dark it is. NaN where a rig sends no light.
    patterns : ndarray of float32, shape (P, *projector_shape)
    captured, relit : ndarray of float32, shape (P, *camera_shape, C)
        Radiance; rays that the camera doesn't know are 0 in both.
    gain : ndarray of float64, shape (C,)
        Light of the lamp relative to the acquisition's beginning; divided out of `captured`.
    """

    table: pd.DataFrame
    patterns: Float
    captured: Float
    relit: Float
    gain: NDArray[np.float64]

    @property
    def mean_error(self) -> float:
        """Mean of the pictures' errors; NaN where none has light."""
        return float(self.table["error"].mean())

    @property
    def worst(self) -> Any:
        """The row of the largest error, whose ``name`` is the picture's."""
        return self.table.set_index("name").iloc[int(self.table["error"].fillna(-1).argmax())]

    @property
    def standard_error(self) -> float:
        """Standard error of the mean error, for pictures of this kind."""
        errors, noise = (self.table[name].dropna() for name in ("error", "standard_error"))
        spread = float(errors.var()) if len(errors) > 1 else 0.0
        return float(np.sqrt((spread + np.square(noise).mean()) / max(len(errors), 1)))

    def against(self, target: float | None) -> Outcome:
        """Compare the mean error with the target that the method had."""
        from rfpipe.config.model import TARGET_MARGIN

        error = self.mean_error
        if target is None:
            return Outcome("unknown", "the method has no target_error")
        if np.isnan(error):
            return Outcome("unknown", "no picture has light above its noise")
        if error <= target:
            return Outcome("met", f"{percent(error)}% of {percent(target)}%")
        text = (
            f"the error is {percent(error)}% +- {percent(self.standard_error)}%, "
            f"{percent(target)}% was the target"
        )
        if error <= TARGET_MARGIN * target:
            return Outcome("unsure", f"{text}: {len(self.table)} pictures don't tell more")
        return Outcome("missed", text)

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest; None for what isn't known."""
        rows = self.table.astype(object).where(self.table.notna(), None)
        noise, worst = self.table["noise"].mean(), self.worst
        numbers = {"mean_error": self.mean_error, "worst_error": worst.error, "noise": noise}
        return {
            "pictures": rows.to_dict("records"),
            **{name: float(it) if np.isfinite(it) else None for name, it in numbers.items()},
            "worst_picture": worst.name,
            "gain": self.gain.tolist(),
        }


def compare(
    patterns: Float,
    captured: tuple[Float, Float],
    relit: Float,
    gain: NDArray[np.float64],
    floodlit: tuple[Float, Float],
) -> Verification:
    """Compare captured pictures and their variance with relit ones; shapes as of `Verification`.

    `floodlit` is the image under the all-on pattern, and its variance, (*camera_shape, C). Pictures
    are named by their kinds: the patterns are the first of `relighting_pictures`.

    Notes
    -----
    With ``d = relit - captured`` and the variance v of each sample, ``sum d^2`` is expected to be
    ``sum (error^2 + v)``: the noise's share is known, and is taken off. The rest has the standard
    deviation ``sqrt(sum (2 v^2 + 4 v error^2))``. The noise of the transport itself is part of its
    error. Of saturated samples neither is known: they don't count.
    """
    import pandas as pd

    known = np.isfinite(captured[0]) & np.isfinite(captured[1])
    judged = known & ~are_saturated(*captured)
    observed, relit = np.where(known, captured[0], 0), np.where(known, relit, 0)
    seen = np.where(np.isfinite(floodlit[0]) & np.isfinite(floodlit[1]), floodlit, 0).astype(
        np.float64
    )
    full = float((np.square(seen[0]) - seen[1]).sum())
    rows = []
    for index, pattern in enumerate(patterns):
        v = np.where(judged[index], captured[1][index], 0).astype(np.float64)
        squares = np.square(relit[index].astype(np.float64) - observed[index]) * judged[index]
        noise = float(v.sum())
        own = np.square(observed[index], dtype=np.float64).sum() - noise
        light = float(reference_light(own, full * np.square(pattern, dtype=np.float64).mean()))
        error = np.sqrt(max(float(squares.sum()) - noise, 0.0))
        spread = float(np.sqrt((2 * np.square(v) + 4 * v * np.maximum(squares - v, 0)).sum()))
        # far from zero half the relative error of the square; near it, the root of its spread
        deviation = min(np.sqrt(spread), spread / (2 * error) if error else np.inf)
        unit = np.sqrt(light) if light > 0 else np.nan
        lengths = [np.sqrt(squares.sum()), np.sqrt(noise), error, deviation]
        name = f"{KINDS[index % len(KINDS)]} {index // len(KINDS) + 1}"
        plain = error / np.sqrt(own) if own > 0 else np.nan
        rows.append([name, *(float(length / unit) for length in lengths), float(plain)])
    columns = ["name", "difference", "noise", "error", "standard_error", "plain_error"]
    table = pd.DataFrame(rows, columns=columns)
    return Verification(table, patterns, observed, relit, np.asarray(gain, np.float64))


def schedule_of(shape: tuple[int, ...], pictures: int) -> Schedule:
    """Return the patterns, over a `shape`, of the pictures that verify a transport."""
    weights = relighting_pictures(shape, pictures, _SEED)
    return Schedule(VERIFICATION, shape, pictures, weights=weights)


def run(context: CaptureContext, pictures: int) -> None:
    """Verify the transport of an acquisition that the caller locks; its manifest comes last.

    Parameters
    ----------
    pictures : int
        Number of pictures, at least 1.
    """
    storage = context.storage
    assert isinstance(storage, AcquisitionFolder)
    schedule_pictures(storage, pictures)
    captured = verification_context(context, pictures)
    capture.run(captured, VERIFICATION)
    merge.run(captured, VERIFICATION)
    _compare(storage, context.settings.code, context.settings.asymmetry)


def verification_context(context: CaptureContext, pictures: int) -> CaptureContext:
    """Return the inputs of the capture and the merge of the pictures that verify a transport.

    Check pictures are taken before the first picture and after the last, if levels had any.
    """
    storage = context.storage
    captured = [level for level in storage.levels() if storage.exists(level, "capture")]
    is_watched = any(
        CHECK_PICTURES in storage.read_manifest(level, "capture") for level in captured
    )
    settings = replace(
        context.settings,
        symmetry_frames=0,
        batch_patterns=1,
        watch="warn" if is_watched else "off",
        check_interval=pictures,
        divide_out_drift=True,
    )
    return CaptureContext(storage, settings, context.resources, context.rig_source, context.sensor)


def check_bounds(
    manifests: Mapping[str, Mapping[str, Any]], bounds: Mapping[str, float], where: str
) -> None:
    """Refuse acquisitions whose mean error is above a relative bound.

    Raises VerificationError, which names each acquisition above its bound with its worst picture,
    those none of whose pictures has light above noise, and `where`, the page that shows the
    pictures. `manifests` are each ``verification.json``, or ``transport.json`` where no pictures
    were taken, whose last estimate of the error counts; `bounds` have the same names.
    """
    above = [_above(name, manifests[name], bound) for name, bound in bounds.items()]
    above = [text for text in above if text]
    if above:
        raise VerificationError(
            f"{'; '.join(above)}. Set verification.fail_above to accept more. The transport and "
            f"all pictures are kept: see the captured and relit pictures in {where}. "
            "An error that is large under all of them is the rig's (moved, misaligned, a lamp that "
            "changed); else ask the method for a smaller error. What is shown is full light or "
            "none, which doesn't tell of the projector's response"
        )


def _above(name: str, facts: Mapping[str, Any], bound: float) -> str:
    """Describe an error that is above a bound; empty where it isn't."""
    if "levels" in facts:
        error = last_estimate(facts["levels"]).get("estimated_error", 0.0)
        above = f"{name} is off by an estimated {percent(error)}%, above {percent(bound)}%"
        return "" if error <= bound else above
    if facts["mean_error"] is None:
        return f"{name} has no picture with light above its noise: give it more light or exposure"
    if facts["mean_error"] <= bound:
        return ""
    return (
        f"{name} is off by {percent(facts['mean_error'])}% on average, above {percent(bound)}%, by "
        f"{percent(facts['worst_error'])}% under '{facts['worst_picture']}' (noise floor "
        f"{percent(facts['noise'])}%)"
    )


def schedule_pictures(folder: AcquisitionFolder, pictures: int) -> None:
    """Write the patterns once: a transport made anew doesn't ask for other pictures."""
    folder.folder(VERIFICATION).mkdir(exist_ok=True)
    references = folder.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"]
    schedule = schedule_of(read_schedule(folder, 0).shape, pictures)
    made_from = fingerprint([references, schedule.digest()])
    if not folder.current_manifest(VERIFICATION, "schedule", made_from):
        write_schedule(folder, VERIFICATION, made_from, schedule)


def compared(folder: Storage, transport: Transport) -> Verification:
    """Compare the merged pictures that verify a transport with what it makes of them."""
    weights = read_schedule(folder, VERIFICATION).weights
    assert weights is not None
    with folder.frames(VERIFICATION, "merge") as frames:
        images = frames.read(0, len(weights))
    looks = folder.read_manifest(VERIFICATION, "merge").get(CHECK_PICTURES)
    gain = np.mean(looks["gain"], axis=0) if looks else np.ones(transport.channels)
    relit = transport.relight_batch(weights)
    observed = images[:, 0], images[:, 1]
    return compare(weights, observed, relit, gain, read_floodlit(folder))


def _compare(folder: AcquisitionFolder, code: str, asymmetry: float) -> None:
    acquired = read_manifest(folder.path / "transport.json")
    merged = folder.read_manifest(VERIFICATION, "merge")
    result = compared(folder, open_transport(folder.path / "transport.zarr"))
    count, worst = len(result.table), result.worst
    if np.isnan(result.mean_error):
        text = "%s: not verified: of %s none has light above its noise on rays that are seen"
        _log.warning(text, folder.path, counted(count, "picture"))
    else:
        _log.info(
            "%s: %s for verification: the transport is off by %s %% on average, by %s %% under "
            "'%s' (noise floor of the pictures %s %%)",
            folder.path, counted(count, "picture"), percent(result.mean_error),
            percent(worst.error), worst.name, percent(result.table["noise"].mean()),
        )  # fmt: skip
    made_from = fingerprint([acquired["digest"], merged["digest"], code])
    arrays = {name: getattr(result, name) for name in ("patterns", "captured", "relit")}
    about = {name: acquired[name] for name in ("scene", "method")}
    facts = {"stage": "verification", "transport": acquired["digest"], "units": RADIANCE_UNIT}
    facts |= about | result.facts() | _rig_facts(folder, asymmetry)
    facts |= _outcome(result, acquired["options"].get("target_error"), facts)
    if facts["standing"] == "missed":
        _log.warning("%s: the target is MISSED: %s", folder.path, facts["reason"])
    write_result(folder.path / VERIFICATION_MANIFEST, made_from, arrays, facts)


def _outcome(
    result: Verification, target: float | None, facts: Mapping[str, Any]
) -> dict[str, Any]:
    """Target, standing, and the reason with its likely cause, for the manifest."""
    outcome = result.against(target)
    cause = ""
    if outcome.standing == "missed":
        if facts["alarms"]:
            noticed = dict.fromkeys(alarm.partition(": ")[2] for alarm in facts["alarms"])
            cause = f". Noticed during the capture: {'; '.join(noticed)}"
        elif facts["saturated"] > _MOST_SATURATED * facts["samples"]:
            cause = ". Pictures are saturated: add a shorter exposure"
        elif facts["noise"] is not None and target is not None and facts["noise"] > target:
            cause = ". The pictures' noise is above the target: give them more light or exposure"
    return {
        "target_error": target,
        "standard_error": _finite(result.standard_error),
        "standing": outcome.standing,
        "reason": outcome.reason + cause,
    }


def _finite(number: float) -> float | None:
    return number if np.isfinite(number) else None


def _rig_facts(folder: AcquisitionFolder, asymmetry: float) -> dict[str, Any]:
    """Sum up the looks at the rig of all levels; None where there were none."""
    levels = [*folder.levels(), VERIFICATION]
    merged = {level: folder.read_manifest(level, "merge") for level in levels}
    looks = {
        level: facts[CHECK_PICTURES] for level, facts in merged.items() if CHECK_PICTURES in facts
    }
    rig = folder.read_manifest(0, "capture")["rig"]
    of_rig = calibration_fault(folder, rig, asymmetry)
    drift = [float(np.abs(np.asarray(look["gain"]) - 1).max()) for look in looks.values()]
    return {
        "drift": max(drift, default=None),
        "moved": max((max(look["change"]) for look in looks.values()), default=None),
        "alarms": [
            *([f"level 0: {of_rig}"] if of_rig else []),
            *(f"{level_name(at)}: {alarm}" for at in looks for alarm in changes_of(looks[at])),
        ],
        "saturated": sum(facts["saturated"] for facts in merged.values()),
        "samples": sum(facts["samples"] for facts in merged.values()),
    }
