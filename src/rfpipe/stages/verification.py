"""Stage: pictures that no method saw are taken, and compared with what the transport makes of them.

They go the way of all pictures. A stage that was stopped goes on at the picture where it stopped; a
transport that was made anew is compared with the same pictures.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import VerificationError
from rfpipe.patterns import Schedule
from rfpipe.provenance import fingerprint, generator
from rfpipe.stages import merge
from rfpipe.stages.folder import VERIFICATION, AcquisitionFolder, name_of, write_bundle
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merger import REFERENCES
from rfpipe.stages.schedule import read_schedule, write_schedule
from rfpipe.stages.watch import MOVES
from rfpipe.store import read_manifest
from rfpipe.transport import Transport, open_transport
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    import pandas as pd

MANIFEST = "verification.json"
"""The result of a verification, beside the transport that it is about."""

NAMES = (
    "natural", "stripes", "steep", "spots", "bands", "rings", "grain", "checks", "slope", "gaps",
)  # fmt: skip
"""Names of all patterns, the most telling first."""

_SEED = 15  # of what is random in the patterns


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
        means = self.table[["error", "noise"]].mean()
        numbers = {
            "mean_error": means["error"], "worst_error": self.worst.error, "noise": means["noise"]
        }  # fmt: skip
        return {
            "pictures": rows.to_dict("records"),
            **{name: float(it) if np.isfinite(it) else None for name, it in numbers.items()},
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
    """Compare captured pictures and their variance with relit ones; shapes as of `Verification`.

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


def schedule_of(transport: Transport, pictures: int) -> tuple[list[str], Schedule]:
    """Return the names and the patterns of the pictures that verify a transport."""
    shape = transport.projector_shape
    white = transport.T.relight(np.ones(transport.camera_shape, np.float32))
    made = unseen_patterns(shape, pictures, white)
    weights = np.stack(list(made.values()))
    return list(made), Schedule(VERIFICATION, shape, len(made), weights=weights)


def run(
    folder: AcquisitionFolder,
    capture: Callable[..., None],
    *,
    pictures: int,
    settings: Mapping[str, Mapping[str, Any]],
    resources: Resources,
) -> None:
    """Verify the transport of an acquisition that the caller locks; its manifest comes last.

    Parameters
    ----------
    capture : callable
        ``capture(folder, level, **options)``, see `rfpipe.stages.captures`.
    pictures : int
        How many, 1 to 10.
    settings : mapping
        Those of the stages "capture" and "merge", see `rfpipe.stages.plan.stages_of`.
    """
    folder.manifest(VERIFICATION, "schedule").parent.mkdir(exist_ok=True)
    _schedule(folder, pictures)
    # looks at the rig before the first picture and after the last, if there were any before
    was_watched = any(folder.path.glob(f"L[0-9]*/{MOVES}.zarr"))
    options = {
        **settings["capture"],
        "symmetry_frames": 0, "batch_patterns": 1,
        "watching": {"mode": "warn" if was_watched else "off", "looks": pictures},
    }  # fmt: skip
    capture(folder, VERIFICATION, **options, resources=resources.here)
    merging = {**settings["merge"], "divide_out_drift": True}
    merge.run(folder, VERIFICATION, **merging, resources=resources)
    _compare(folder, merging["code"])


def check_bound(manifests: Mapping[str, Mapping[str, Any]], bound: float, where: str) -> None:
    """Refuse verifications whose mean error is above a relative bound.

    Raises VerificationError, which names each acquisition above it with its worst picture, those
    none of whose pictures has light above noise, and `where`, the page that shows the pictures.
    `manifests` are each ``verification.json`` by the acquisition's name.
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
    references = folder.read_manifest(0, "merge")[REFERENCES]["digest"]
    made_from = fingerprint([references, list(NAMES[:pictures])])
    if not folder.standing(VERIFICATION, "schedule", made_from):
        names, schedule = schedule_of(open_transport(folder.path / "transport.zarr"), pictures)
        write_schedule(folder, made_from, schedule, names=names)


def compared(folder: AcquisitionFolder, transport: Transport) -> Verification:
    """Compare the merged pictures that verify a transport with what it makes of them."""
    weights = read_schedule(folder, VERIFICATION).weights
    assert weights is not None
    names = folder.read_manifest(VERIFICATION, "schedule")["names"]
    with folder.frames(VERIFICATION, "merge") as frames:
        images = frames.read(0, len(weights))
    looks = folder.read_manifest(VERIFICATION, "merge").get(MOVES)
    gain = np.mean(looks["gain"], axis=0) if looks else np.ones(transport.channels)
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
    made_from = fingerprint([acquired["digest"], merged["digest"], code])
    arrays = {name: getattr(result, name) for name in ("patterns", "captured", "relit")}
    about = {name: acquired[name] for name in ("scene", "method")}
    facts = {"stage": "verification", "transport": acquired["digest"], "units": RADIANCE_UNIT}
    facts |= about | result.facts() | _rig_facts(folder)
    write_bundle(folder.path / MANIFEST, made_from, arrays, facts)


def _rig_facts(folder: AcquisitionFolder) -> dict[str, Any]:
    """Sum up what the merges of all levels tell of the rig; None where nothing looked."""
    levels = sorted(int(path.parent.name[1:]) for path in folder.path.glob("L[0-9]*/merge.json"))
    merged = {level: folder.read_manifest(level, "merge") for level in [*levels, VERIFICATION]}
    looks = {level: facts[MOVES] for level, facts in merged.items() if MOVES in facts}
    drift = [float(np.abs(np.asarray(look["gain"]) - 1).max()) for look in looks.values()]
    return {
        "drift": max(drift, default=None),
        "moved": max((max(look["change"]) for look in looks.values()), default=None),
        "alarms": [
            f"{name_of(level)}: the rig or the scene moved"
            for level, look in looks.items()
            if look["moved"]
        ],
        **{
            name: sum(facts[name] for facts in merged.values()) for name in ("saturated", "samples")
        },
    }


def unseen_patterns(
    shape: tuple[int, ...], count: int, from_projector: Float | None = None
) -> dict[str, Float]:
    """Return the first `count` patterns, each of the projector's `shape` with weights in [0, 1].

    Parameters
    ----------
    from_projector : ndarray of float32, shape (*shape, C), optional
        The scene as the projector sees it (the dual picture of white light), in which
        ``steep`` finds where brightness changes most. None: across the middle.

    Returns
    -------
    dict of str to ndarray of float32
        ``natural``: discs of all sizes that cover each other, in shades of grey. ``stripes``:
        slanted, five rays a period. ``steep``: the twenty-fifth of the rays where the scene is
        steepest, such as a crease. ``spots``: scattered, three rays wide. ``bands``: broad level
        ones. ``rings``; ``grain``: a fifth of all rays, at random. ``checks``: squares of seven
        rays. ``slope``: a ramp from dark to light. ``gaps``: all but scattered spots.

    Notes ----- The natural picture is made by the dead-leaves model, which has the statistics of
    photographs [A. B. Lee, D. Mumford and J. Huang, Occlusion models for natural images,
    International Journal of Computer Vision 41, 2001].
    """
    domain = RayDomain(tuple(shape))
    height, width = domain.image_shape
    shorter = min(height, width)
    y, x = np.mgrid[:height, :width]
    spots = _spots(height, width)
    pictures: dict[str, NDArray[np.generic]] = {
        "natural": _natural(height, width),
        "stripes": (x + y // 3) % 5 < 2,
        "steep": x == width // 2 if from_projector is None else _steep(domain, from_projector),
        "spots": spots,
        "bands": (y + max(1, height // 11)) % max(2, height // 3) < max(1, height // 7),
        "rings": np.hypot(y - 0.4 * height, x - 0.6 * width) % max(3.0, shorter / 4) < shorter / 10,
        "grain": generator(_SEED, 2).random((height, width)) < 0.2,
        "checks": (y // 7 + x // 7) % 2 == 1,
        "slope": ((y + 0.5) / height + (x + 0.5) / width) / 2,
        "gaps": ~spots[::-1, ::-1],
    }
    made = {}
    for name in NAMES[:count]:
        picture = np.asarray(pictures[name], np.float32)
        if not picture.any():
            picture[height // 2, width // 2] = 1
        made[name] = np.ascontiguousarray(np.broadcast_to(picture, shape))
    return made


def _natural(height: int, width: int) -> NDArray[np.float64]:
    """Draw 400 discs whose radii follow r^-3, between a ray and the longer side."""
    random = generator(_SEED, 0)
    y, x = np.mgrid[:height, :width] + 0.5
    picture = np.full((height, width), 0.5)
    longest = 1 / float(max(height, width)) ** 2
    for _ in range(400):
        radius = 1 / np.sqrt(1 - random.random() * (1 - longest))
        at_y, at_x = random.random(2) * (height + radius, width + radius) - radius / 2
        picture[(y - at_y) ** 2 + (x - at_x) ** 2 < radius**2] = random.random()
    return picture


def _spots(height: int, width: int) -> NDArray[np.bool_]:
    lit = np.zeros((height, width), np.bool_)
    random = generator(_SEED, 1)
    for _ in range(max(1, height * width // 128)):
        top, left = random.integers(0, height), random.integers(0, width)
        lit[max(0, top - 1) : top + 2, max(0, left - 1) : left + 2] = True
    return lit


def _steep(domain: RayDomain, from_projector: Float) -> NDArray[np.bool_]:
    """Find the rays of the middle view where relative brightness changes most from ray to ray."""
    from scipy.ndimage import gaussian_filter

    stack = from_projector.reshape(*domain.stack_shape, -1)
    image = stack[len(stack) // 2].mean(axis=-1, dtype=np.float64)
    smooth = gaussian_filter(image, min(image.shape) / 32)
    least = 1e-3 * float(smooth.max(initial=0.0)) or 1.0
    steps = [
        np.gradient(smooth, axis=axis) if length > 1 else np.zeros_like(smooth)
        for axis, length in enumerate(image.shape)
    ]
    steepness = np.hypot(*steps) / np.maximum(smooth, least)
    return np.asarray(steepness >= np.quantile(steepness, 0.96))
