"""Stage: verify a transport by pictures that no method uses.

The pictures are captured and merged like a level's, so that an interrupted capture resumes, and a
transport that is assembled again is compared with the same pictures.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import VerificationError
from rfpipe.jobs.targets import misses
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
    scheduled_levels,
)
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.results import write_result
from rfpipe.store import read_manifest
from rfpipe.text import counted, percent
from rfpipe.transport import Transport, open_transport
from rfpipe.transport.base import last_estimate
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    import pandas as pd

_SEED = 15
"""Seed of the verification patterns."""

_MAX_SATURATED = 0.01
"""Share of saturated samples above which a missed target is attributed to saturation."""


_log = logging.getLogger(__name__)


class TargetComparison(NamedTuple):
    """Comparison of an error with its target.

    Attributes
    ----------
    verdict : {"met", "unsure", "missed", "unknown"}
        "unsure": the error is above the target, but at most `TARGET_MARGIN` times the target, which
        is within the scatter of few pictures.
    reason : str
        Error and target, and a likely cause.
    """

    verdict: Literal["met", "unsure", "missed", "unknown"]
    reason: str


@dataclass(frozen=True, eq=False)
class Verification:
    """Error of a transport in verification pictures.

    Attributes
    ----------
    table : DataFrame
        A row for each picture, over the unmasked rays; values are relative to the picture's light,
        see `rfpipe.relighting.picture_errors`, and NaN without light.

        ``name``; ``difference``: ``||relit - captured||``; ``noise``: norm of the noise that the
        captured picture is expected to have; ``error``: ``sqrt(difference^2 - noise^2)``, 0 where
        the difference is below the noise; ``standard_error``; ``plain_error``: the error
        relative to the picture's norm, however dark it is.
    patterns : ndarray of float32, shape (P, *projector_shape)
    captured, relit : ndarray of float32, shape (P, *camera_shape, C)
        Radiance; 0 at masked rays.
    gain : ndarray of float64, shape (C,)
        Brightness of the lamp relative to the first check picture; divided out of `captured`.
    """

    table: pd.DataFrame
    patterns: Float
    captured: Float
    relit: Float
    gain: NDArray[np.float64]

    @property
    def mean_error(self) -> float:
        """Mean of the pictures' errors; NaN without light in any picture."""
        return float(self.table["error"].mean())

    @property
    def worst(self) -> Any:
        """Row of the largest error, whose ``name`` is the picture's."""
        return self.table.set_index("name").iloc[int(self.table["error"].fillna(-1).argmax())]

    @property
    def standard_error(self) -> float:
        """Standard error of the mean error as an estimate over all such pictures."""
        errors, noise = (self.table[name].dropna() for name in ("error", "standard_error"))
        spread = float(errors.var()) if len(errors) > 1 else 0.0
        return float(np.sqrt((spread + np.square(noise).mean()) / max(len(errors), 1)))

    def against(self, target: float | None) -> TargetComparison:
        """Compare the mean error with the target error of the method."""
        from rfpipe.config.model import TARGET_MARGIN

        error = self.mean_error
        if target is None:
            return TargetComparison("unknown", "the method has no target_error")
        if np.isnan(error):
            return TargetComparison("unknown", "no picture has light above its noise")
        if error <= target:
            return TargetComparison("met", f"{percent(error)}% of {percent(target)}%")
        text = (
            f"the error is {percent(error)}% +- {percent(self.standard_error)}%, "
            f"{percent(target)}% was the target"
        )
        if any(misses({"target_error": target}, (error, None), {}, TARGET_MARGIN)):
            return TargetComparison("missed", text)
        return TargetComparison(
            "unsure", f"{text}: {len(self.table)} pictures are too few to decide"
        )

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest; unknown values are None."""
        rows = self.table.astype(object).where(self.table.notna(), None)
        return {
            "pictures": rows.to_dict("records"),
            "mean_error": _finite(self.mean_error),
            "worst_error": _finite(float(self.worst.error)),
            "noise": _finite(float(self.table["noise"].mean())),
            "worst_picture": self.worst.name,
            "gain": self.gain.tolist(),
        }


def run(context: CaptureContext, pictures: int) -> None:
    """Verify the transport of an acquisition, and write the result and its manifest.

    Parameters
    ----------
    context : CaptureContext
        The caller locks its storage.
    pictures : int
        Number of pictures, at least 1.
    """
    storage = context.storage
    assert isinstance(storage, FolderStorage)
    schedule_pictures(storage, pictures)
    picture_context = verification_context(context, pictures)
    capture.run(picture_context, VERIFICATION)
    merge.run(picture_context, VERIFICATION)
    _verify_and_write(storage, context.settings.code, context.settings.accepted_asymmetry)


def schedule_pictures(folder: FolderStorage, pictures: int) -> None:
    """Write the verification patterns, unless they are written already."""
    folder.folder(VERIFICATION).mkdir(exist_ok=True)
    references = folder.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"]
    schedule = verification_schedule(read_schedule(folder, 0).shape, pictures)
    inputs_fingerprint = fingerprint([references, schedule.digest()])
    if not folder.current_manifest(VERIFICATION, "schedule", inputs_fingerprint):
        write_schedule(folder, VERIFICATION, inputs_fingerprint, schedule)


def verification_schedule(projector_shape: tuple[int, ...], pictures: int) -> Schedule:
    """Return the patterns that verify a transport."""
    weights = relighting_pictures(projector_shape, pictures, _SEED)
    return Schedule(VERIFICATION, projector_shape, pictures, weights=weights)


def verification_context(context: CaptureContext, pictures: int) -> CaptureContext:
    """Return the inputs of capture and merge for the verification pictures.

    Check pictures are taken before the first and after the last picture, if levels had any.
    """
    storage = context.storage
    captured = [level for level in scheduled_levels(storage) if storage.exists(level, "capture")]
    is_watched = any(
        CHECK_PICTURES in storage.read_manifest(level, "capture") for level in captured
    )
    settings = replace(
        context.settings,
        symmetry_brackets=0,
        batch_patterns=1,
        watch="warn" if is_watched else "off",
        check_interval=pictures,
        divide_out_drift=True,
    )
    return CaptureContext(storage, settings, context.resources, context.rig_source, context.sensor)


def verify(storage: Storage, transport: Transport) -> Verification:
    """Relight a transport with the verification patterns, and compare with the merged pictures."""
    weights = read_schedule(storage, VERIFICATION).weights
    assert weights is not None
    with storage.pictures(VERIFICATION, "merge") as store:
        images = store.read(0, len(weights))
    drift = storage.read_manifest(VERIFICATION, "merge").get(CHECK_PICTURES)
    gain = np.mean(drift["gain"], axis=0) if drift else np.ones(transport.channels)
    relit = transport.relight_batch(weights)
    return compare_with_captured(
        weights, (images[:, 0], images[:, 1]), relit, gain, read_floodlit(storage)
    )


def compare_with_captured(
    patterns: Float,
    captured: tuple[Float, Float],
    relit: Float,
    gain: NDArray[np.float64],
    floodlit: tuple[Float, Float],
) -> Verification:
    """Compare captured pictures with relit ones.

    Parameters
    ----------
    patterns : ndarray of float32, shape (P, *projector_shape)
        The first of `relighting_pictures`, which name the pictures.
    captured : (ndarray of float32, ndarray of float32), shape (P, *camera_shape, C)
        Radiance and its variance.
    relit : ndarray of float32, shape (P, *camera_shape, C)
    gain : ndarray of float64, shape (C,)
        See `Verification`.
    floodlit : (ndarray of float32, ndarray of float32), shape (*camera_shape, C)
        Floodlit image and its variance.

    Notes
    -----
    With ``d = relit - captured`` and the variance v of each sample, ``sum d^2`` has the expectation
    ``sum (error^2 + v)``, from which ``sum v`` is subtracted, and the standard deviation
    ``sqrt(sum (2 v^2 + 4 v error^2))``. The noise of the transport is part of its error. Saturated
    samples are excluded.
    """
    import pandas as pd

    known = np.isfinite(captured[0]) & np.isfinite(captured[1])
    judged = known & ~are_saturated(*captured)
    observed, relit = np.where(known, captured[0], 0), np.where(known, relit, 0)
    is_known = np.isfinite(floodlit[0]) & np.isfinite(floodlit[1])
    floodlit_light, floodlit_noise = np.where(is_known, floodlit, 0).astype(np.float64)
    floodlit_energy = float((np.square(floodlit_light) - floodlit_noise).sum())
    rows = []
    for index, pattern in enumerate(patterns):
        variance = np.where(judged[index], captured[1][index], 0).astype(np.float64)
        squares = np.square(relit[index].astype(np.float64) - observed[index]) * judged[index]
        energy = float(np.square(observed[index], dtype=np.float64).sum() - variance.sum())
        typical = floodlit_energy * np.square(pattern, dtype=np.float64).mean()
        name = f"{KINDS[index % len(KINDS)]} {index // len(KINDS) + 1}"
        rows.append([name, *_errors(squares, variance, energy, typical)])
    columns = ["name", "difference", "noise", "error", "standard_error", "plain_error"]
    table = pd.DataFrame(rows, columns=columns)
    return Verification(table, patterns, observed, relit, np.asarray(gain, np.float64))


def _errors(
    squares: NDArray[np.float64], variance: NDArray[np.float64], energy: float, typical: float
) -> list[float]:
    """Return the numbers of a picture: the columns of `Verification.table` after its name.

    Parameters
    ----------
    squares, variance : ndarray of float64, shape (*camera_shape, C)
        Squared differences, and variance of the captured picture; 0 where it isn't judged.
    energy : float
        Squared norm of the captured picture, without its noise.
    typical : float
        Squared norm of the floodlit image times the mean squared pattern.
    """
    noise = float(variance.sum())
    light = float(reference_light(np.asarray(energy), typical))
    error = np.sqrt(max(float(squares.sum()) - noise, 0.0))
    terms = 2 * np.square(variance) + 4 * variance * np.maximum(squares - variance, 0)
    spread = float(np.sqrt(terms.sum()))
    # far from zero half the relative error of the square; near it, the root of its spread
    deviation = min(np.sqrt(spread), spread / (2 * error) if error else np.inf)
    unit = np.sqrt(light) if light > 0 else np.nan
    lengths = [np.sqrt(squares.sum()), np.sqrt(noise), error, deviation]
    plain_error = float(error / np.sqrt(energy)) if energy > 0 else float("nan")
    return [*(float(length / unit) for length in lengths), plain_error]


def _verify_and_write(folder: FolderStorage, code: str, asymmetry: float) -> None:
    """Compare the stored transport with the merged pictures; log and write the result."""
    acquired = read_manifest(folder.path / "transport.json")
    merged = folder.read_manifest(VERIFICATION, "merge")
    result = verify(folder, open_transport(folder.path / "transport.zarr"))
    _log_result(folder, result)
    facts = {
        "stage": "verification",
        "transport": acquired["digest"],
        "units": RADIANCE_UNIT,
        "scene": acquired["scene"],
        "method": acquired["method"],
        **result.facts(),
        **_capture_facts(folder, asymmetry),
    }
    facts |= _outcome_facts(result, acquired["options"].get("target_error"), facts)
    if facts["verdict"] == "missed":
        _log.warning("%s: the target is MISSED: %s", folder.path, facts["reason"])
    arrays = {"patterns": result.patterns, "captured": result.captured, "relit": result.relit}
    inputs_fingerprint = fingerprint([acquired["digest"], merged["digest"], code])
    write_result(folder.path / VERIFICATION_MANIFEST, inputs_fingerprint, arrays, facts)


def _log_result(folder: FolderStorage, result: Verification) -> None:
    count, worst = len(result.table), result.worst
    if np.isnan(result.mean_error):
        text = "%s: not verified: none of %s has light above its noise on unmasked rays"
        _log.warning(text, folder.path, counted(count, "picture"))
        return
    _log.info(
        "%s: verified by %s: the mean error is %s %%, the largest %s %% under '%s' (noise floor of "
        "the pictures %s %%)",
        folder.path, counted(count, "picture"), percent(result.mean_error),
        percent(worst.error), worst.name, percent(result.table["noise"].mean()),
    )  # fmt: skip


def _outcome_facts(
    result: Verification, target: float | None, facts: Mapping[str, Any]
) -> dict[str, Any]:
    """Return target, verdict, and the reason with its likely cause, for the manifest."""
    outcome = result.against(target)
    cause = ""
    if outcome.verdict == "missed":
        if facts["alarms"]:
            changes = dict.fromkeys(alarm.partition(": ")[2] for alarm in facts["alarms"])
            cause = f". Noticed during the capture: {'; '.join(changes)}"
        elif facts["saturated"] > _MAX_SATURATED * facts["samples"]:
            cause = ". Pictures are saturated: add a shorter exposure"
        elif facts["noise"] is not None and target is not None and facts["noise"] > target:
            cause = ". The pictures' noise is above the target: give them more light or exposure"
    return {
        "target_error": target,
        "standard_error": _finite(result.standard_error),
        "verdict": outcome.verdict,
        "reason": outcome.reason + cause,
    }


def _finite(number: float) -> float | None:
    """Return a number, or None for NaN and infinity."""
    return number if np.isfinite(number) else None


def _capture_facts(folder: FolderStorage, asymmetry: float) -> dict[str, Any]:
    """Summarize changes and saturation of all captures; None without check pictures."""
    levels = [*scheduled_levels(folder), VERIFICATION]
    merged = {level: folder.read_manifest(level, "merge") for level in levels}
    drifts = {
        level: facts[CHECK_PICTURES] for level, facts in merged.items() if CHECK_PICTURES in facts
    }
    rig = folder.read_manifest(0, "capture")["rig"]
    fault = calibration_fault(folder, rig, asymmetry)
    brightness = [np.abs(np.asarray(drift["gain"]) - 1).max() for drift in drifts.values()]
    return {
        "drift": float(max(brightness)) if brightness else None,
        "moved": max((max(drift["change"]) for drift in drifts.values()), default=None),
        "alarms": [
            *([f"level 0: {fault}"] if fault else []),
            *(
                f"{level_name(level)}: {change}"
                for level, drift in drifts.items()
                for change in changes_of(drift)
            ),
        ],
        "saturated": sum(facts["saturated"] for facts in merged.values()),
        "samples": sum(facts["samples"] for facts in merged.values()),
    }


def check_bounds(
    manifests: Mapping[str, Mapping[str, Any]], bounds: Mapping[str, float], page: str
) -> None:
    """Check that the mean error of each acquisition is within a bound.

    Parameters
    ----------
    manifests : mapping
        By name of the acquisition, ``verification.json``, or ``transport.json`` without
        verification pictures, whose last error estimate is compared.
    bounds : mapping
        Relative bounds, by the same names.
    page : str
        Page with the pictures, for the message.

    Raises
    ------
    VerificationError
        If an error is above its bound, or no picture has light above its noise.
    """
    excesses = [_excess(name, manifests[name], bound) for name, bound in bounds.items()]
    excesses = [text for text in excesses if text]
    if excesses:
        raise VerificationError(
            "; ".join(excesses),
            remedy="Set verification.fail_above to accept more. The transport and all pictures are "
            f"kept: see the captured and relit pictures in {page}. An error that is large in all "
            "pictures is caused by the rig (moved, misaligned, a lamp that changed); otherwise set "
            "a smaller target error. Patterns are 0 or 1, so that these pictures don't test the "
            "projector's response",
        )


def _excess(name: str, facts: Mapping[str, Any], bound: float) -> str:
    """Describe an error that is above its bound; "" for an error within it."""
    if "levels" in facts:
        error = last_estimate(facts["levels"]).get("estimated_error", 0.0)
        text = f"{name} has an estimated error of {percent(error)}%, above {percent(bound)}%"
        return "" if error <= bound else text
    if facts["mean_error"] is None:
        return f"{name} has no picture with light above its noise: give it more light or exposure"
    if facts["mean_error"] <= bound:
        return ""
    return (
        f"{name} has a mean error of {percent(facts['mean_error'])}%, above {percent(bound)}%, and "
        f"{percent(facts['worst_error'])}% under '{facts['worst_picture']}' (noise floor "
        f"{percent(facts['noise'])}%)"
    )
