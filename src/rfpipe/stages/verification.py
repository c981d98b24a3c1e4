"""Stage: pictures that no method saw are taken, and compared with what the transport makes of them.

They go the way of all pictures: shown and kept one by one, merged with the acquisition's own black
level and defects, brought to the light of its floodlit image. A stage that was stopped goes on at
the picture where it stopped; a transport that was made anew is compared with the same pictures.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import StoreError, VerificationError
from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint
from rfpipe.stages import merge
from rfpipe.stages.folder import VERIFICATION, AcquisitionFolder, name_of, standing, write_bundle
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merger import REFERENCES
from rfpipe.stages.schedule import read_schedule, write_schedule
from rfpipe.stages.unseen import NAMES, unseen_patterns
from rfpipe.stages.watch import DRIFT, MOVES, MUTUAL
from rfpipe.store import read_manifest
from rfpipe.transport import Transport, open_transport
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    import pandas as pd

MANIFEST = "verification.json"
"""The result of a verification, beside the transport that it is about."""

Float = NDArray[np.float32]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Verification:
    """What a transport is wrong by, on pictures that were captured for this alone.

    Attributes
    ----------
    table : DataFrame
        A row a picture, relative to its norm, over the rays that the camera knows: ``name``;
        ``difference``: ``||relit - captured||``; ``noise``: the share of it that is expected of
        the captured picture's noise; ``error``: the difference without that share, 0 where nothing
        but noise is seen; ``standard_error``. NaN where the picture has no light.
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

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest; None for what isn't known."""
        rows = self.table.astype(object).where(self.table.notna(), None)
        numbers = {
            "mean_error": self.mean_error,
            "worst_error": float(self.worst.error),
            "noise": float(self.table["noise"].mean()),
        }
        return {
            "pictures": rows.to_dict("records"),
            **{name: value if np.isfinite(value) else None for name, value in numbers.items()},
            "worst_picture": self.worst.name,
            "gain": [float(gain) for gain in self.gain],
        }


def compare(
    names: Sequence[str],
    patterns: Float,
    captured: tuple[Float, Float],
    relit: Float,
    gain: NDArray[np.float64],
) -> Verification:
    """Compare captured pictures with relit ones.

    Parameters
    ----------
    names : sequence of P str
    patterns, relit, gain
        As in `Verification`.
    captured : tuple of two ndarrays of float32, shape (P, *camera_shape, C)
        Radiance and its variance, infinite where the camera doesn't know it.

    Notes
    -----
    With ``d = relit - captured`` and the variance v of each sample, ``sum d^2`` is expected to be
    ``sum (error^2 + v)``: the noise's share is known, and is taken off. The rest has the standard
    deviation ``sqrt(sum (2 v^2 + 4 v error^2))``. The noise of the transport itself is part of its
    error.
    """
    import pandas as pd

    known = np.isfinite(captured[1])
    observed, relit = np.where(known, captured[0], 0), np.where(known, relit, 0)
    rows = []
    for index, name in enumerate(names):
        v = np.where(known[index], captured[1][index], 0).astype(np.float64)
        squares = np.square(relit[index].astype(np.float64) - observed[index])
        noise = float(v.sum())
        light = float(np.square(observed[index], dtype=np.float64).sum()) - noise
        if light <= 0:
            rows.append([name, *[np.nan] * 4])
            continue
        error = np.sqrt(max(float(squares.sum()) - noise, 0.0))
        spread = float(np.sqrt((2 * np.square(v) + 4 * v * np.maximum(squares - v, 0)).sum()))
        # far from zero half the relative error of the square; near it, the root of its spread
        deviation = min(np.sqrt(spread), spread / (2 * error) if error else np.inf)
        lengths = [np.sqrt(squares.sum()), np.sqrt(noise), error, deviation]
        rows.append([name, *(float(length / np.sqrt(light)) for length in lengths)])
    columns = ["name", "difference", "noise", "error", "standard_error"]
    table = pd.DataFrame(rows, columns=columns)
    return Verification(table, patterns, observed, relit, np.asarray(gain, np.float64))


def schedule_of(
    transport: Transport, pictures: int, level: int = VERIFICATION
) -> tuple[list[str], Schedule]:
    """Return the names and the patterns of the pictures that verify a transport."""
    shape = transport.projector_shape
    white = transport.T.relight(np.ones(transport.camera_shape, np.float32))
    made = unseen_patterns(shape, pictures, white)
    return list(made), Schedule(level, shape, len(made), weights=np.stack(list(made.values())))


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
        As the stages; captured pictures are kept.
    """
    manifest = folder.manifest(VERIFICATION, "schedule")
    manifest.parent.mkdir(exist_ok=True)
    _schedule(folder, pictures)
    # looks at the rig before the first picture and after the last, if there were any before
    was_watched = any(folder.path.glob(f"L[0-9]*/{MOVES}.zarr"))
    options = {
        **settings["capture"],
        "symmetry_frames": 0,
        "drift_patterns": pictures,
        "batch_patterns": 1,
        "watching": {"mode": "warn" if was_watched else "off", "looks": pictures},
    }
    capture(folder, VERIFICATION, **options, resources=resources.here)
    merging = {**settings["merge"], "divide_out_drift": True}
    merge.run(folder, VERIFICATION, **merging, resources=resources)
    _compare(folder, merging["code"])


def check_bound(manifests: Mapping[str, Mapping[str, Any]], bound: float, where: str) -> None:
    """Refuse verifications whose mean error is above a bound.

    Parameters
    ----------
    manifests : mapping of str to mapping
        Each ``verification.json``, by the acquisition's name.
    bound : float
        Largest mean error, relative.
    where : str
        The page that shows the pictures.

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


def _schedule(folder: AcquisitionFolder, pictures: int) -> None:
    """Write the patterns once: a transport made anew doesn't ask for other pictures."""
    manifest = folder.manifest(VERIFICATION, "schedule")
    references = folder.read_manifest(0, "merge")[REFERENCES]["digest"]
    made_from = fingerprint([references, list(NAMES[:pictures])])
    if not standing(manifest, made_from):
        transport = open_transport(folder.path / "transport.zarr")
        names, schedule = schedule_of(transport, pictures)
        write_schedule(folder, made_from, schedule, names=names)


def compared(folder: AcquisitionFolder, transport: Transport) -> Verification:
    """Compare the merged pictures that verify a transport with what it makes of them."""
    weights = read_schedule(folder, VERIFICATION).weights
    assert weights is not None
    names = folder.read_manifest(VERIFICATION, "schedule")["names"]
    with folder.frames(VERIFICATION, "merge") as frames:
        images = frames.read(0, len(weights))
    gain = np.mean(folder.read_manifest(VERIFICATION, "merge")[DRIFT]["gain"], axis=0)
    relit = transport.relight_batch(weights)
    return compare(names, weights, (images[:, 0], images[:, 1]), relit, gain)


def _compare(folder: AcquisitionFolder, code: str) -> None:
    acquired = read_manifest(folder.path / "transport.json")
    merged = folder.read_manifest(VERIFICATION, "merge")
    result = compared(folder, open_transport(folder.path / "transport.zarr"))
    _log.info(
        "%s: %d pictures that no method saw are relit to %.2f %% on average, '%s' to %.2f %% "
        "(noise floor of the pictures %.2f %%)",
        folder.path, len(result.table), 100 * result.mean_error, result.worst.name,
        100 * result.worst.error, 100 * result.table["noise"].mean(),
    )  # fmt: skip
    write_bundle(
        folder.path / MANIFEST,
        fingerprint([acquired["digest"], merged["digest"], code]),
        {name: getattr(result, name) for name in ("patterns", "captured", "relit")},
        {
            "stage": "verification",
            "transport": acquired["digest"],
            "scene": acquired["scene"],
            "method": acquired["method"],
            **result.facts(),
            **_rig_facts(folder),
            "units": RADIANCE_UNIT,
        },
    )


def _rig_facts(folder: AcquisitionFolder) -> dict[str, Any]:
    """Sum up what the manifests of all levels tell of the rig.

    ``drift``, ``moved``: largest change of the lamp's light and of the repeated pattern;
    ``reciprocity``, ``reciprocity_deviations``: error of the worst picture by asymmetry, and
    largest residual in standard deviations; each None where nothing looked. ``alarms``: where the
    rig moved, or wasn't aligned; ``saturated`` of ``samples``; ``devices``: counts.
    """
    levels = list(_levels(folder))
    drift = [np.abs(np.asarray(merged[DRIFT]["gain"]) - 1).max() for _, merged, _ in levels
             if DRIFT in merged]  # fmt: skip
    looks = [(name, merged[MOVES]) for name, merged, _ in levels if MOVES in merged]
    mutual = [(name, captured[MUTUAL]) for name, _, captured in levels if MUTUAL in captured]
    moved = [max([0.0, *look["change"]]) for _, look in looks]
    alarms = [f"{name}: the rig or the scene moved" for name, look in looks if look["moved"]]
    alarms += [
        f"{name}, pattern {of['first']}: not aligned"
        for name, of in mutual
        if of["first"] is not None
    ]
    devices: Counter[str] = Counter()
    for _, _, captured in levels:
        devices.update(captured.get("devices", {}))
    return {
        "drift": max(map(float, drift), default=None),
        "moved": max(moved, default=None),
        "reciprocity": max((of["error"] for _, of in mutual), default=None),
        "reciprocity_deviations": max((of["deviations"] for _, of in mutual), default=None),
        "alarms": alarms,
        **{name: sum(merged[name] for _, merged, _ in levels) for name in ("saturated", "samples")},
        "devices": dict(devices),
    }


def _levels(folder: AcquisitionFolder) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Yield the name and the manifests of merge and capture of each level, the pictures' last."""
    levels = sorted(int(path.parent.name[1:]) for path in folder.path.glob("L[0-9]*/merge.json"))
    for level in [*levels, VERIFICATION]:
        with suppress(StoreError):
            merged, captured = (folder.read_manifest(level, name) for name in ("merge", "capture"))
            yield name_of(level), merged, captured
