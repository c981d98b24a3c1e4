"""Stage: pictures that no method saw are taken, and compared with what the transport makes of them.

They go the way of all pictures: shown and kept one by one, merged with the acquisition's own black
level and defects, brought to the light of its floodlit image. A stage that was stopped goes on at
the picture where it stopped; a transport that was made anew is compared with the same pictures.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rfpipe.errors import StoreError, VerificationError
from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint
from rfpipe.stages import merge
from rfpipe.stages.folder import VERIFICATION, AcquisitionFolder, name_of
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merger import REFERENCES
from rfpipe.stages.results import standing, write_bundle
from rfpipe.stages.schedule import read_schedule, write_schedule
from rfpipe.stages.unseen.comparing import Verification, compare
from rfpipe.stages.unseen.patterns import NAMES, unseen_patterns
from rfpipe.stages.watch import DRIFT, MOVES, MUTUAL
from rfpipe.store import read_manifest
from rfpipe.transport import Transport, open_transport
from rfpipe.units import RADIANCE_UNIT

__all__ = ["MANIFEST", "check_bound", "run", "schedule_of"]

MANIFEST = "verification.json"
"""What a verification found, beside the transport that it is about."""

_log = logging.getLogger(__name__)


def run(
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    *,
    pictures: int,
    settings: Mapping[str, Mapping[str, Any]],
    resources: Resources,
) -> None:
    """Verify the transport of an acquisition; ``verification.json`` beside it comes last.

    Parameters
    ----------
    folder : AcquisitionFolder
        With ``transport.json``; locked by the caller.
    capture : callable
        ``capture(folder, level, **options)``, see `rfpipe.stages.captures`.
    pictures : int
        How many, 1 to 10.
    settings : mapping
        Those of the stages "capture" and "merge", see `rfpipe.stages.plan.stages_of`.
    resources : Resources

    Raises
    ------
    RfpipeError
        As the stages; what is captured is kept.
    """
    folder.manifest(VERIFICATION, "schedule").parent.mkdir(exist_ok=True)
    with stage_log(folder.manifest(VERIFICATION, "schedule").with_suffix(".log")):
        _schedule(folder, pictures)
    with stage_log(folder.manifest(VERIFICATION, "capture").with_suffix(".log")):
        capture(
            folder,
            VERIFICATION,
            **{
                **settings["capture"],
                "symmetry_frames": 0,
                # a look at the lamp before the first and after the last
                "drift_patterns": pictures,
                "batch_patterns": 1,
                "watching": _watching(folder, pictures),
            },
            resources=resources.here,
        )
    merging = {**settings["merge"], "divide_out_drift": True}
    with stage_log(folder.manifest(VERIFICATION, "merge").with_suffix(".log")):
        merge.run(folder, VERIFICATION, **merging, resources=resources)
    _compare(folder, merging["code"])


def schedule_of(
    transport: Transport, pictures: int, level: int = VERIFICATION
) -> tuple[list[str], Schedule]:
    """Return the names and the patterns of the pictures that verify a transport."""
    white = np.ones(transport.camera_shape, np.float32)
    shape = transport.projector_shape
    made = unseen_patterns(shape, pictures, transport.T.relight(white))
    return list(made), Schedule(level, shape, len(made), weights=np.stack(list(made.values())))


def check_bound(manifests: Mapping[str, Mapping[str, Any]], bound: float, where: str) -> None:
    """Refuse verifications whose mean error is above a bound.

    Parameters
    ----------
    manifests : mapping of str to mapping
        What stands in ``verification.json``, by the acquisition's name.
    bound : float
        Largest mean error, relative.
    where : str
        Where to look.

    Raises
    ------
    VerificationError
        Names each acquisition that is above it, and its worst picture; or none of whose pictures
        has light above noise.
    """
    above = [
        f"{name} is off by {facts['mean_error']:.2%} on average, by {facts['worst_error']:.2%} "
        f"under '{facts['worst_picture']}' (noise floor {facts['noise']:.2%})"
        if facts["mean_error"] is not None
        else f"{name} has no picture with light above its noise: give it more light or exposure"
        for name, facts in manifests.items()
        if facts["mean_error"] is None or facts["mean_error"] > bound
    ]
    if above:
        raise VerificationError(
            f"{'; '.join(above)}. At most {bound:.2%} is accepted (verification.fail_above). The "
            f"transport and all pictures are kept: see the captured and relit pictures in {where}. "
            "An error that is large under all of them is the rig's (moved, misaligned, a lamp that "
            "changed); one under 'natural' and 'slope' alone is the projector's response; else ask "
            "the method for a smaller error"
        )


def compared(folder: AcquisitionFolder, transport: Transport) -> Verification:
    """Compare the merged pictures that verify a transport with what it makes of them."""
    schedule = read_schedule(folder, VERIFICATION)
    assert schedule.weights is not None
    names = folder.read_manifest(VERIFICATION, "schedule")["names"]
    with folder.frames(VERIFICATION, "merge") as frames:
        images = frames.read(0, schedule.count)
    gain = np.mean(folder.read_manifest(VERIFICATION, "merge")[DRIFT]["gain"], axis=0)
    relit = transport.relight_batch(schedule.weights)
    return compare(names, schedule.weights, (images[:, 0], images[:, 1]), relit, gain)


def _watching(folder: AcquisitionFolder, pictures: int) -> dict[str, Any]:
    """Look at the rig before the first picture and after the last, if it was looked at before."""
    was_watched = any(folder.path.glob(f"L[0-9]*/{MOVES}.zarr"))
    return {"mode": "warn" if was_watched else "off", "looks": pictures}


def _schedule(folder: AcquisitionFolder, pictures: int) -> None:
    """Write the patterns once: a transport made anew doesn't ask for other pictures."""
    manifest = folder.manifest(VERIFICATION, "schedule")
    references = folder.read_manifest(0, "merge")[REFERENCES]["digest"]
    made_from = fingerprint([references, list(NAMES[:pictures])])
    if standing(manifest, made_from):
        return
    transport = open_transport(folder.path / "transport.zarr")
    names, schedule = schedule_of(transport, pictures)
    write_schedule(folder, made_from, schedule, names=names)


def _compare(folder: AcquisitionFolder, code: str) -> None:
    manifest = folder.path / MANIFEST
    acquired = read_manifest(folder.path / "transport.json")
    merged = folder.read_manifest(VERIFICATION, "merge")
    made_from = fingerprint([acquired["digest"], merged["digest"], code])
    found = compared(folder, open_transport(folder.path / "transport.zarr"))
    told(found, str(folder.path))
    write_bundle(
        manifest,
        made_from,
        {name: getattr(found, name) for name in ("patterns", "captured", "relit")},
        {
            "stage": "verification",
            "transport": acquired["digest"],
            "scene": acquired["scene"],
            "method": acquired["method"],
            **found.facts(),
            **_of_all_levels(folder),
            "units": RADIANCE_UNIT,
        },
    )


def told(found: Verification, name: str) -> None:
    """Log what a verification found."""
    worst = found.worst
    _log.info(
        "%s: %d pictures that no method saw are relit to %.2f %% on average, '%s' to %.2f %% "
        "(noise floor of the pictures %.2f %%)",
        name, len(found.compared), 100 * found.mean_error, worst.name, 100 * worst.error,
        100 * np.mean([one.noise for one in found.compared]),
    )  # fmt: skip


def _of_all_levels(folder: AcquisitionFolder) -> dict[str, Any]:
    """Return what else tells of the rig: drift, moves, reciprocity, saturation, its devices."""
    levels = [int(place.parent.name[1:]) for place in folder.path.glob("L[0-9]*/merge.json")]
    found = _OfLevels()
    for level in [*sorted(levels), VERIFICATION]:
        try:
            merged = folder.read_manifest(level, "merge")
            captured = folder.read_manifest(level, "capture")
        except StoreError:
            continue
        found.add(name_of(level), merged, captured)
    return vars(found)


@dataclass
class _OfLevels:
    """What the manifests of all levels tell of the rig.

    Attributes
    ----------
    drift, moved : float or None
        Largest change of the lamp's light, and of the repeated pattern, relative; None where
        nothing looked.
    reciprocity : float or None
        Error of the worst picture by asymmetry, at least, None where it wasn't watched; 0: none.
    reciprocity_deviations : float or None
        Largest residual of reciprocity, in standard deviations.
    alarms : list of str
        Where the rig moved, or wasn't aligned, first at each level.
    saturated, samples : int
    devices : dict of str to int
        What the devices counted, such as frames that failed.
    """

    drift: float | None = None
    moved: float | None = None
    reciprocity: float | None = None
    reciprocity_deviations: float | None = None
    alarms: list[str] = field(default_factory=list)
    saturated: int = 0
    samples: int = 0
    devices: dict[str, int] = field(default_factory=dict)

    def add(self, name: str, merged: dict[str, Any], captured: dict[str, Any]) -> None:
        """Add a level's."""
        self.saturated += merged["saturated"]
        self.samples += merged["samples"]
        if DRIFT in merged:
            gains = np.asarray(merged[DRIFT]["gain"])
            self.drift = max(self.drift or 0.0, float(np.abs(gains - 1).max(initial=0.0)))
        if MOVES in merged:
            looks = merged[MOVES]
            self.moved = max(self.moved or 0.0, *looks["change"])
            if looks["moved"]:
                self.alarms.append(f"{name}: the rig or the scene moved")
        if MUTUAL in captured:
            mutual = captured[MUTUAL]
            self.reciprocity = max(self.reciprocity or 0.0, mutual["error"])
            worst = max(self.reciprocity_deviations or 0.0, mutual["deviations"])
            self.reciprocity_deviations = worst
            if mutual["first"] is not None:
                self.alarms.append(f"{name}, pattern {mutual['first']}: not aligned")
        for what, count in captured.get("devices", {}).items():
            self.devices[what] = self.devices.get(what, 0) + count
