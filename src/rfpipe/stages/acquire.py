"""A whole acquisition in this process: the workflow's stages without its files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError, InputError
from rfpipe.keys import DRIFT_KEY
from rfpipe.methods import Method, get_method, options_of
from rfpipe.patterns import Schedule
from rfpipe.photometry import ExactSensor
from rfpipe.photometry.normalize import Mode
from rfpipe.photometry.reciprocity import Reciprocity
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch, sequence_patterns
from rfpipe.stages.capturing.drift import look
from rfpipe.stages.capturing.mutual import MutualWatch, Tally
from rfpipe.stages.capturing.shown import Keys, reference_patterns, symmetry_patterns
from rfpipe.stages.folder import name_of
from rfpipe.stages.jobs.progress import log_estimate
from rfpipe.stages.merging.images import (
    ImagesInMemory,
    NormalizedImages,
    known_light,
    masked_rays,
    normalize_level,
)
from rfpipe.stages.merging.merger import LevelSum, Merger, runs
from rfpipe.stages.symmetry import NOTICED, Asymmetry, measure
from rfpipe.stages.unseen.comparing import Verification, compare
from rfpipe.stages.unseen.patterns import NAMES
from rfpipe.stages.unseen.verify import schedule_of
from rfpipe.transport import Transport
from rfpipe.transport.filling import fill_from_transpose
from rfpipe.units import SATURATION_FRACTION

if TYPE_CHECKING:
    import pandas as pd

_BATCH = 16

_Patterns = Callable[[int, int], tuple[NDArray[np.float32], Keys]]


@dataclass(frozen=True)
class AcquisitionResult:
    """What an acquisition in process returns.

    Attributes
    ----------
    transport : Transport
    patterns : int
        Patterns shown, the floodlit one included, the all-off ones not.
    capture_seconds, processing_seconds : float
        Wall time inside the rig, and of everything else.
    saturated : int
        Samples that were saturated in every exposure; 0 in a well exposed acquisition.
    masked : ndarray of bool, shape (*camera_shape)
        Camera rays that were left out, since they are dead or hot.
    verification : Verification or None
        What the transport is wrong by on pictures that the method didn't see, if any were taken;
        ``verification.table`` has a row a picture.
    reciprocity : tuple of dict
        For each level of a method that takes the rig for a coaxial one: pictures ``judged``,
        largest residual in standard ``deviations`` (about 1 on a right rig), ``error`` in relit
        pictures that it means at least, and the ``first`` picture that was wrong, None for none.
    """

    transport: Transport
    patterns: int
    capture_seconds: float
    processing_seconds: float
    saturated: int
    masked: NDArray[np.bool_]
    verification: Verification | None = None
    reciprocity: tuple[dict[str, Any], ...] = ()

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
    normalization: Mode = "per_channel",
    black_frames: int = 8,
    floodlit_frames: int = 64,
    symmetry_frames: int = 6,
    asymmetry: float = 0.05,
    mask_defects: bool = True,
    saturation_fraction: float = SATURATION_FRACTION,
    verification: int = 0,
    watch: Literal["off", "warn", "refuse"] = "warn",
    **options: Any,
) -> AcquisitionResult:
    """Acquire the transport between a rig's projector and camera.

    Parameters
    ----------
    rig : Rig
    method : str or Method
        A name in `rfpipe.methods.method_names`, the path of a class of one's own as
        ``module:Class`` or ``file.py:Class``, or a method itself.
    progress : bool
        Whether to show a progress bar a level on stderr, and to log what methods estimate of
        their error.
    normalization : {"per_channel", "none", "total_energy"}
        How a level's images are made to add up to the floodlit image (thesis B.2).
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
    saturation_fraction : float
        Counts from this fraction of full scale on are not used.
    verification : int
        Pictures that the method doesn't see, taken afterwards to compare the transport with, up to
        10; 0 for none.
    watch : {"off", "warn", "refuse"}
        What to do when the pictures of a method that takes the rig for a coaxial one tell that it
        isn't, or not any more.
    **options
        The method's own: its ``Options``, such as ``tolerance``, the error allowed in an image as
        a fraction of the floodlit image's maximum, of "symmetric" and "dual", or
        ``target_error``, the mean error of relit pictures at which these and "near_far" stop.

    Returns
    -------
    AcquisitionResult

    Raises
    ------
    InputError
        If the method lacks an option, one is out of range, the method does not fit the rig, or
        the rig is none.
    CaptureError
        If the rig fails or returns what can't be a picture, or isn't coaxial and the method needs
        it.
    """
    if not hasattr(rig, "capture"):
        raise InputError(
            f"{type(rig).__name__} is no rig; make one of a matrix or linear operator: "
            "rfpipe.OperatorRig(matrix, camera_shape=(h, w), projector_shape=(h, w))"
        )
    chosen = get_method(method)
    asked = options_of(chosen, **options)
    chosen = chosen.with_options(asked)
    if min(black_frames, floodlit_frames) < 1:
        raise InputError(
            f"black_frames is {black_frames} and floodlit_frames {floodlit_frames}; "
            "at least one of each is needed"
        )
    if symmetry_frames < 0 or symmetry_frames in (1, 2):
        raise InputError(f"symmetry_frames is {symmetry_frames}; 0, or 3 or more, are needed")
    if not 0 <= verification <= len(NAMES):
        raise InputError(f"verification is {verification}; 0 to {len(NAMES)} pictures can be taken")
    began = perf_counter()
    camera, projector = RayDomain(rig.camera_shape), RayDomain(rig.projector_shape)
    asks_symmetry = chosen.asks_symmetry(camera, projector) and symmetry_frames > 0
    chosen.start(camera, projector, rig.channels, asked)  # refuses what it can't take
    session = _Session(
        rig,
        progress,
        (1, 1) if isinstance(rig.sensor, ExactSensor) else (black_frames, floodlit_frames),
        saturation_fraction=saturation_fraction,
        mask_defects=mask_defects,
    )
    if asks_symmetry:
        chosen = session.symmetry(symmetry_frames).judge(chosen, asked, asymmetry)
    elif camera.shape != projector.shape:
        chosen = chosen.on_rig(coaxial=False)
    chosen = chosen.with_options(asked)
    state = chosen.start(camera, projector, rig.channels, asked)
    if chosen.needs_coaxial_rig and watch != "off":
        session.watch(NOTICED * asymmetry, refuse=watch == "refuse")
    shown = saturated = 0
    for _ in range(chosen.n_levels(camera, projector)):
        schedule = chosen.schedule(state)
        shown += schedule.count
        merged, level_sum = session.capture(schedule)
        saturated += level_sum.saturated
        gain = normalize_level(
            schedule,
            level_sum,
            (session.merger.floodlit, session.merger.floodlit_variance),
            None if normalization == "none" else known_light(chosen, state, schedule),
            normalization,
            asked.noise_significance,
        )
        state = chosen.refine(state, NormalizedImages(schedule, merged, gain))
        if progress:
            log_estimate(state.rows, asked)
    masked = masked_rays(session.merger.floodlit_variance)
    transport = fill_from_transpose(chosen.transport(state), masked)
    verified = session.verify(transport, verification) if verification else None
    processing = perf_counter() - began - session.capture_seconds
    return AcquisitionResult(
        transport, shown, session.capture_seconds, processing, saturated, masked, verified,
        tuple(tally.facts() for tally in session.tallies),
    )  # fmt: skip


class _Session:
    """One acquisition's dealings with the rig; begins with the all-off and all-on brackets."""

    def __init__(
        self, rig: Rig, progress: bool, references: tuple[int, int], **merging: Any
    ) -> None:
        self.rig = rig
        self.progress = progress
        self.capture_seconds = 0.0
        self._batch = sequence_patterns(rig) or _BATCH
        self.tallies: list[Tally] = []
        self._mutual: Callable[[Schedule], MutualWatch] | None = None
        off, on = references
        self.merger = Merger.from_references(
            rig.sensor, self._reference(off, 0, off), self._reference(off, off, off + on), **merging
        )

    def symmetry(self, count: int) -> Asymmetry:
        """Measure by random patterns whether the rig is coaxial."""

        def patterns(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
            return symmetry_patterns(self.rig.projector_shape, count, first, last)

        return measure(self.merger, self._shown(patterns, 0, count), count)

    def watch(self, worth_a_word: float, *, refuse: bool) -> None:
        """From now on hold each picture against those before it, as a coaxial rig's."""
        if not self.merger.floodlit.any():
            return
        reciprocity = Reciprocity(self.merger.floodlit, self.merger.floodlit_variance)

        def of_level(schedule: Schedule) -> MutualWatch:
            tally = Tally(name_of(schedule.level), worth_a_word, refuse)
            self.tallies.append(tally)
            return MutualWatch(reciprocity, schedule.batch, tally)

        self._mutual = of_level

    def verify(self, transport: Transport, count: int) -> Verification:
        """Take pictures that no method saw, between two looks at the lamp, and compare them."""
        names, schedule = schedule_of(transport, count)
        self._mutual = None

        def lamp(index: int) -> NDArray[np.float64]:
            white = np.ones((1, *self.rig.projector_shape), np.float32)
            bracket = self._show(white, [(DRIFT_KEY, schedule.level, index)])
            return look(self.merger, bracket, index)[0]

        before = lamp(0)
        images, _ = self.capture(schedule)
        gain = np.mean([before, lamp(1)], axis=0)
        scale = np.where(gain > 0, gain, 1).astype(np.float32)
        captured = images.radiance / scale, images.variance / scale**2
        assert schedule.weights is not None
        relit = transport.relight_batch(schedule.weights)
        return compare(names, schedule.weights, captured, relit, gain)

    def capture(self, schedule: Schedule) -> tuple[ImagesInMemory, LevelSum]:
        """Capture and merge the patterns of a level; also return their sum."""
        from tqdm import tqdm

        image_shape = (*self.rig.camera_shape, self.rig.channels)
        shape = (schedule.count, *image_shape)
        radiance, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        total = LevelSum.zero(image_shape)
        is_judged = self._mutual and schedule.count and schedule.level
        mutual = self._mutual(schedule) if self._mutual and is_judged else None
        with tqdm(
            total=schedule.count,
            desc=name_of(schedule.level),
            unit="pattern",
            disable=not self.progress,
        ) as bar:
            for start, stop in runs(schedule.count, image_shape):
                run = LevelSum.zero(image_shape)
                for first in range(start, stop, self._batch):
                    last = min(first + self._batch, stop)
                    keys = [(schedule.level, index) for index in range(first, last)]
                    frames = self._show(schedule.batch(first, last), keys)
                    merged = self.merger.merge(frames, first)
                    run.add(merged)
                    if mutual:
                        mutual.judge(first, merged)
                    radiance[first:last], variance[first:last] = merged.radiance, merged.variance
                    bar.update(last - first)
                total.join(run)
        return ImagesInMemory(radiance, variance), total

    def _reference(self, black_frames: int, first: int, last: int) -> Iterator[NDArray[Any]]:
        """Take the brackets that an acquisition begins with, a few at a time."""

        def patterns(first: int, last: int) -> tuple[NDArray[np.float32], Keys]:
            return reference_patterns(self.rig.projector_shape, black_frames, first, last)

        return self._shown(patterns, first, last)

    def _shown(self, patterns: _Patterns, first: int, last: int) -> Iterator[NDArray[Any]]:
        """Show patterns, a few at a time."""
        for start in range(first, last, self._batch):
            yield self._show(*patterns(start, min(start + self._batch, last)))

    def _show(self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]) -> NDArray[Any]:
        began = perf_counter()
        frames = capture_batch(self.rig, patterns, keys)
        self.capture_seconds += perf_counter() - began
        expected = self.rig.sensor.frame_shape(self.rig.camera_shape, self.rig.channels)
        if frames.shape != (len(patterns), *expected):
            raise CaptureError(
                f"pattern {tuple(keys[0])}: the rig returned frames of shape {frames.shape[1:]}; "
                f"expected {tuple(expected)}. Check the camera's size, pixel format and exposures"
            )
        return frames
