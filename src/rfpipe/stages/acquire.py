"""A whole acquisition in this process: the workflow's stages without its files."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import NDArray

from rfpipe.config.capture import PRECAUTIONS, Watch
from rfpipe.errors import InputError, StoreError
from rfpipe.jobs.workers import Resources
from rfpipe.methods import Method, get_method
from rfpipe.rigs import Rig
from rfpipe.rigs.base import is_simulated
from rfpipe.stages import capture
from rfpipe.stages.acquisition import run_levels
from rfpipe.stages.assemble import assembled
from rfpipe.stages.plan import Plan
from rfpipe.stages.schedule import write_schedule
from rfpipe.stages.verification import Verification, capture_and_merge, compared, schedule_of
from rfpipe.storage.files import AcquisitionFolder, Arrays, Facts
from rfpipe.transport import Transport
from rfpipe.units import RADIANCE

if TYPE_CHECKING:
    import pandas as pd

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AcquisitionResult:
    """What an acquisition in process returns.

    Attributes
    ----------
    transport : Transport
    patterns : int
        Patterns shown, the floodlit one included, the all-off ones not.
    capture_seconds, processing_seconds : float
        Wall time of captures, and of everything else.
    saturated : int
        Samples that were saturated in every exposure; 0 in a well exposed acquisition.
    masked : ndarray of bool, shape (*camera_shape)
        Camera rays that were left out, since they are dead or hot.
    verification : Verification or None
        Errors of the transport on pictures that the method didn't see, if any were taken;
        ``verification.table`` has a row a picture.
    """

    transport: Transport
    patterns: int
    capture_seconds: float
    processing_seconds: float
    saturated: int
    masked: NDArray[np.bool_]
    verification: Verification | None = None

    def __repr__(self) -> str:
        about = f"{self.patterns} patterns, {self.seconds:.3g} s, {self.transport}"
        return f"AcquisitionResult({about})"

    @property
    def levels(self) -> pd.DataFrame:
        """The table of levels, see `Transport.levels`."""
        return self.transport.levels

    @property
    def history(self) -> pd.DataFrame:
        """The method's own estimates of its error while it ran, see `Transport.history`."""
        return self.transport.history

    @property
    def seconds(self) -> float:
        """Wall time of the acquisition."""
        return self.capture_seconds + self.processing_seconds


def acquire(
    rig: Rig,
    method: str | Method[Any] = "symmetric",
    *,
    progress: bool = True,
    black_frames: int = 8,
    floodlit_frames: int = 64,
    symmetry_frames: int = 6,
    asymmetry: float = 0.05,
    mask_defects: bool = True,
    watch: Watch | None = None,
    divide_out_drift: bool | None = None,
    verification: int | None = None,
    **options: Any,
) -> AcquisitionResult:
    """Acquire the transport between a rig's projector and camera.

    Ctrl-C ends it with what the levels before have told, if there is one.

    Parameters
    ----------
    rig : Rig
    method : str or Method
        A name in `rfpipe.methods.method_names`, the path of a class of one's own as
        ``module:Class`` or ``file.py:Class``, or a method itself.
    progress : bool
        Whether to show progress bars of captures and fits on stderr, and to log what methods
        estimate of their error.
    black_frames : int
        All-off brackets whose mean is subtracted; at least 1. Exact radiance takes one.
    floodlit_frames : int
        All-on brackets to whose mean each level's images are scaled; at least 1. Exact radiance
        takes one.
    symmetry_frames : int
        Brackets of random patterns by which methods see whether the rig is coaxial, if they ask,
        3 or more; 0 for none.
    asymmetry : float
        Error in relit pictures, relative to their norm, that taking the rig for a coaxial one may
        make.
    mask_defects : bool
        Whether dead and hot pixels are left out. On a coaxial rig, what other pixels see of their
        light fills them in at the end; otherwise their rows of T are zero.
    watch : {"off", "warn", "refuse"}, optional
        What to do where pictures show that the rig or its light changed: "refuse" raises
        CaptureError. None: "refuse", "off" with a simulated rig.
    divide_out_drift : bool, optional
        Whether images are divided by the lamp's brightness. None: with rigs that aren't simulated.
    verification : int, optional
        Pictures that the method doesn't see, taken afterwards to compare the transport with; 0 for
        none. None: 9, 0 with a simulated rig.
    **options
        The method's own: its ``Options``, such as ``tolerance``, the error allowed in an image as
        a fraction of the floodlit image's maximum, of "symmetric" and "dual", or
        ``target_error``, the mean error of relit pictures at which most methods can stop.

    Returns
    -------
    AcquisitionResult

    Raises
    ------
    InputError
        If the method lacks an option, one is out of range, the method does not fit the rig, or
        `rig` can't capture.
    CaptureError
        If the rig fails or returns what can't be a picture, if it isn't coaxial and the method
        needs it, or if it or its light changes and `watch` is "refuse".
    """
    if not hasattr(rig, "capture"):
        raise InputError(
            f"{type(rig).__name__} is no rig; make one of a matrix or linear operator: "
            "rfpipe.OperatorRig(matrix, camera_shape=(h, w), projector_shape=(h, w))"
        )
    precautions = PRECAUTIONS["simulated" if is_simulated(rig) else "remote"]
    watch = precautions.watch if watch is None else watch
    if verification is None:
        verification = precautions.verification_pictures
    _check(black_frames, floodlit_frames, symmetry_frames, verification, watch)
    began = perf_counter()
    named = get_method(method)
    plan = Plan(
        named.name, named, rig.camera_shape, rig.projector_shape, rig.channels, options, asymmetry
    )
    folder = AcquisitionInMemory()
    capturing: dict[str, Any] = {
        "references": (black_frames, floodlit_frames), "progress": progress,
        "symmetry_frames": symmetry_frames if plan.asks_symmetry else 0,
        "watching": {
            "mode": watch, "asymmetry": asymmetry,
            "check_interval": precautions.check_interval or PRECAUTIONS["remote"].check_interval,
        },
    }  # fmt: skip
    code = {"code": ""}  # nothing is kept that it made
    merging: dict[str, Any] = {
        "mask_defects": mask_defects, "sensor": rig.sensor, "progress": False, **code,
        "divide_out_drift": (
            precautions.divide_out_drift if divide_out_drift is None else divide_out_drift
        ),
    }  # fmt: skip
    settings = {
        "schedule": code, "capture": capturing, "merge": merging,
        "normalize": {"mode": "per_channel", **code},
        "refine": {"progress": progress, **code},
    }  # fmt: skip
    resources = Resources()
    try:
        run_levels(plan, folder, partial(capture.run, rig), settings, resources)
    except KeyboardInterrupt:
        if not plan.end_early():
            raise
        _log.warning("stopped: what all levels before told is returned")
        verification = 0
    transport, masked = assembled(plan, folder)
    verified = None
    if verification:
        write_schedule(folder, "", schedule_of(rig.projector_shape, verification))
        capture_and_merge(folder, partial(_captured, rig), verification, settings, resources)
        verified = compared(folder, transport)
        outcome = verified.against(getattr(plan.options, "target_error", None))
        if outcome.standing == "missed":
            _log.warning("the target is missed: %s", outcome.reason)
    levels = [level for level in folder.levels() if folder.exists(level, "refine")]
    captured, merged = (
        [folder.read_manifest(level, stage) for level in levels] for stage in ("capture", "merge")
    )
    return AcquisitionResult(
        transport,
        sum(facts["patterns"] for facts in captured),
        folder.seconds["capture"],
        perf_counter() - began - folder.seconds["capture"],
        sum(facts["saturated"] for facts in merged),
        masked,
        verified,
    )


def _check(
    black_frames: int, floodlit_frames: int, symmetry_frames: int, verification: int, watch: str
) -> None:
    """Raise InputError for arguments of `acquire` that are out of range."""
    if min(black_frames, floodlit_frames) < 1:
        raise InputError(
            f"black_frames is {black_frames} and floodlit_frames {floodlit_frames}; "
            "at least one of each is needed"
        )
    if symmetry_frames < 0 or symmetry_frames in (1, 2):
        raise InputError(f"symmetry_frames is {symmetry_frames}; 0, or 3 or more, are needed")
    if watch not in get_args(Watch):
        raise InputError(f"watch is {watch!r}; expected one of {', '.join(get_args(Watch))}")
    if verification < 0:
        raise InputError(f"verification is {verification}; 0 or more pictures can be taken")


def _captured(rig: Rig, folder: AcquisitionFolder, level: int, **options: Any) -> None:
    """Capture a level outside `run_levels`, which counts the seconds itself."""
    with folder.doing(level, "capture"):
        capture.run(rig, folder, level, **options)


# ruff: noqa: D102, ARG002 - methods and arguments below are those of AcquisitionFolder and FrameStore


class AcquisitionInMemory(AcquisitionFolder):
    """An acquisition that ends with its process: no digests, and no raw frames once merged.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time of each stage.
    """

    def __init__(self) -> None:
        super().__init__(Path())
        self._held: dict[tuple[int, str], tuple[Arrays, Facts]] = {}
        self._manifests: dict[tuple[int, str], Facts] = {}
        self._frames: dict[Path, FramesInMemory] = {}
        self.seconds: dict[str, float] = defaultdict(float)

    @property
    def is_kept(self) -> bool:
        return False

    def exists(self, level: int, stage: str) -> bool:
        return (level, stage) in self._manifests

    def read_manifest(self, level: int, stage: str) -> Facts:
        return self._manifests[level, stage]

    def standing(self, level: int, stage: str, made_from: str) -> Facts | None:
        return None

    def write_part(self, level: int, part: str, arrays: Arrays, **about: Any) -> Facts:
        self._held[level, part] = arrays, about
        return {"digest": ""}

    def write_manifest(self, level: int, stage: str, facts: Facts) -> None:
        self._manifests[level, stage] = facts

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Facts]:
        return self._held[level, part or stage]

    def frames(self, level: int, stage: str, part: str | None = None) -> Any:
        return nullcontext(self._frames[self.store(level, part or stage)])

    def open_frames(self, level: int, part: str) -> Any:
        path = self.store(level, part)
        if path not in self._frames:
            raise StoreError(f"{path}: was not captured")
        return nullcontext(self._frames[path])

    def recording(
        self, path: Path, shape: tuple[int, ...], dtype: Any, made_for: str, shown: Facts
    ) -> Any:
        self._frames[path] = FramesInMemory(shape, dtype)
        return nullcontext(self._frames[path])

    @contextmanager
    def merging(
        self, level: int, shape: tuple[int, ...], made_from: str, layout: tuple[int, int]
    ) -> Iterator[Any]:
        images = self._frames[self.store(level, "merge")] = FramesInMemory(shape, RADIANCE)
        yield images, images
        del self._frames[self.store(level, "capture")]

    @contextmanager
    def doing(self, level: int, stage: str) -> Iterator[None]:
        began = perf_counter()
        yield
        self.seconds[stage] += perf_counter() - began


class FramesInMemory:
    """Frames in memory, with what stages use of `rfpipe.store.FrameStore` and `ItemWriter`."""

    dropped = False

    def __init__(self, shape: tuple[int, ...], dtype: Any) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self.done = np.zeros(shape[0], np.bool_)
        self._items = np.empty(shape, dtype)

    @property
    def complete(self) -> bool:
        return bool(self.done.all())

    def missing(self, longest: int) -> list[tuple[int, int]]:
        stop = self.shape[0]
        return [(first, min(first + longest, stop)) for first in range(0, stop, longest)]

    def write(self, start: int, block: NDArray[Any]) -> list[str]:
        self._items[start : start + len(block)] = block
        self.done[start : start + len(block)] = True
        return []

    @contextmanager
    def adding(self, start: int) -> Iterator[Any]:
        at = count(start)
        yield lambda block: [self.write(next(at), item[None]) for item in block] and []

    def enter(self, start: int, digests: list[str]) -> None:
        """Do nothing: there is no journal."""

    def read(self, start: int, stop: int) -> NDArray[Any]:
        return self._items[start:stop]

    def entry(self) -> dict[str, Any]:
        return {"digest": "", "dtype": self.dtype.str, "shape": list(self.shape)}
