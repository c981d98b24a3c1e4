"""A whole acquisition in this process: the workflow's stages without its files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods import get_method
from rfpipe.methods.base import Settings
from rfpipe.patterns import Schedule
from rfpipe.photometry import ExactSensor
from rfpipe.photometry.normalize import Mode
from rfpipe.rigs import Rig
from rfpipe.stages.jobs.progress import log_estimate
from rfpipe.stages.merging.images import (
    ImagesInMemory,
    NormalizedImages,
    known_light,
    normalize_level,
)
from rfpipe.stages.merging.merger import LevelSum, Merger, reference_patterns, runs
from rfpipe.transport import Transport

if TYPE_CHECKING:
    import pandas as pd

_BATCH = 16


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
    """

    transport: Transport
    patterns: int
    capture_seconds: float
    processing_seconds: float
    saturated: int

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
    method: str = "symmetric",
    tolerance: float = 1e-3,
    progress: bool = True,
    *,
    noise_significance: float = 3.0,
    subtract_stored: bool = False,
    target_error: float | None = None,
    patterns: int = 0,
    normalization: Mode = "per_channel",
    black_frames: int = 8,
    floodlit_frames: int = 64,
    repair_defects: bool = True,
    saturation_fraction: float = 0.98,
) -> AcquisitionResult:
    """Acquire the transport between a rig's projector and camera.

    Parameters
    ----------
    rig : Rig
    method : str
        A name in `rfpipe.methods.METHODS`. "symmetric", "near_far" and "low_rank" need a coaxial
        rig, camera and projector on one ray domain.
    tolerance : float
        Error allowed in an image, as a fraction of the floodlit image's maximum; above 0.
    progress : bool
        Whether to show a progress bar a level on stderr, and to log what methods estimate of
        their error.
    noise_significance : float
        Standard deviations that make a measured energy significant; at least 0.
    subtract_stored : bool
        Dual photography: whether to take the light stored at coarser levels off finer images.
        The thesis does not, and counts some of it twice.
    target_error : float, optional
        Methods that estimate their own error ("near_far", "low_rank"): the error at which they
        stop, relative to the norm of a relit image, between 0 and 1; None is 0.01.
    patterns : int
        Patterns that "near_far", "low_rank" and "compressive" may show, the floodlit one included;
        0 leaves it to the method.
    normalization : {"per_channel", "none", "total_energy"}
        How a level's images are made to add up to the floodlit image (thesis B.2).
    black_frames : int
        All-off brackets whose mean is subtracted; at least 1. Exact radiance takes one.
    floodlit_frames : int
        All-on brackets to whose mean each level's images are scaled; at least 1. Exact radiance
        takes one.
    repair_defects : bool
        Whether dead and hot pixels are filled in from their neighbours.
    saturation_fraction : float
        Counts from this fraction of full scale on are not used.

    Returns
    -------
    AcquisitionResult

    Raises
    ------
    InputError
        If a setting is out of range or the method does not fit the rig.
    CaptureError
        If the rig fails or returns what can't be a picture.
    """
    settings = _settings(tolerance, noise_significance, subtract_stored, target_error, patterns)
    if min(black_frames, floodlit_frames) < 1:
        raise InputError(
            f"black_frames is {black_frames} and floodlit_frames {floodlit_frames}; "
            "at least one of each is needed"
        )
    began = perf_counter()
    camera, projector = RayDomain(rig.camera_shape), RayDomain(rig.projector_shape)
    plan = get_method(method)
    n_levels = plan.n_levels(camera, projector)
    state = plan.start(camera, projector, rig.channels, settings)
    session = _Session(
        rig,
        progress,
        (1, 1) if isinstance(rig.sensor, ExactSensor) else (black_frames, floodlit_frames),
        saturation_fraction=saturation_fraction,
        repair_defects=repair_defects,
    )
    shown = 0
    for _ in range(n_levels):
        schedule = plan.schedule(state)
        shown += schedule.count
        merged, level_sum = session.capture(schedule)
        gain = normalize_level(
            schedule,
            level_sum,
            (session.merger.floodlit, session.merger.floodlit_variance),
            None if normalization == "none" else known_light(plan, state, schedule),
            normalization,
            noise_significance,
        )
        state = plan.refine(state, NormalizedImages(schedule, merged, gain))
        if progress:
            log_estimate(state.rows, settings.target_error)
    transport = plan.transport(state)
    processing = perf_counter() - began - session.capture_seconds
    return AcquisitionResult(
        transport, shown, session.capture_seconds, processing, session.saturated
    )


def _settings(
    tolerance: float,
    noise_significance: float,
    subtract_stored: bool,
    target_error: float | None,
    patterns: int,
) -> Settings:
    if not tolerance > 0 or not np.isfinite(tolerance):
        raise InputError(f"tolerance is {tolerance}; it must be a finite number above 0")
    if target_error is None:
        target_error = Settings.target_error
    if not 0 < target_error < 1:
        raise InputError(f"target_error is {target_error}; it must be a number between 0 and 1")
    if patterns < 0:
        raise InputError(f"patterns is {patterns}; it must be at least 0, 0 for the method's own")
    return Settings(tolerance, noise_significance, subtract_stored, target_error, patterns)


class _Session:
    """One acquisition's dealings with the rig; begins with the all-off and all-on brackets."""

    def __init__(
        self, rig: Rig, progress: bool, references: tuple[int, int], **merging: Any
    ) -> None:
        self.rig = rig
        self.progress = progress
        self.capture_seconds = 0.0
        self.saturated = 0
        off, on = references
        self.merger = Merger.calibrate(
            rig.sensor, self._reference(off, 0, off), self._reference(off, off, off + on), **merging
        )

    def capture(self, schedule: Schedule) -> tuple[ImagesInMemory, LevelSum]:
        """Capture and merge the patterns of a level; also return their sum."""
        from tqdm import tqdm

        image_shape = (*self.rig.camera_shape, self.rig.channels)
        shape = (schedule.count, *image_shape)
        radiance, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        total = LevelSum.zero(image_shape)
        with tqdm(
            total=schedule.count,
            desc=f"level {schedule.level}",
            unit="pattern",
            disable=not self.progress,
        ) as bar:
            for start, stop in runs(schedule.count, image_shape):
                run = LevelSum.zero(image_shape)
                for first in range(start, stop, _BATCH):
                    last = min(first + _BATCH, stop)
                    keys = [(schedule.level, index) for index in range(first, last)]
                    frames = self._show(schedule.batch(first, last), keys)
                    merged = self.merger.merge(frames, first)
                    run.add(merged)
                    radiance[first:last], variance[first:last] = merged.radiance, merged.variance
                    self.saturated += merged.saturated
                    bar.update(last - first)
                total.join(run)
        return ImagesInMemory(radiance, variance), total

    def _reference(self, black_frames: int, first: int, last: int) -> Iterator[NDArray[Any]]:
        """Take the brackets that an acquisition begins with, a few at a time."""
        for start in range(first, last, _BATCH):
            stop = min(start + _BATCH, last)
            shown = reference_patterns(self.rig.projector_shape, black_frames, start, stop)
            yield self._show(*shown)

    def _show(self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]) -> NDArray[Any]:
        began = perf_counter()
        frames = self.rig.capture(patterns, keys)
        self.capture_seconds += perf_counter() - began
        return frames
