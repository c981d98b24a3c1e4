"""A whole acquisition in this process: the workflow's stages without its files."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import NDArray

from rfpipe.config.capture import PRECAUTIONS, WatchMode
from rfpipe.errors import InputError
from rfpipe.methods import MethodDescription, get_method
from rfpipe.rigs import Rig
from rfpipe.rigs.base import is_simulated
from rfpipe.stages import capture, merge
from rfpipe.stages.acquisition import acquire_levels
from rfpipe.stages.assemble import assembled
from rfpipe.stages.context import Acquisition
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.stages.schedule import write_schedule
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.stages.verification import (
    Verification,
    verification_context,
    verification_schedule,
    verify,
)
from rfpipe.storage.base import VERIFICATION
from rfpipe.storage.memory import MemoryStorage
from rfpipe.storage.picture_counts import PictureCounts, captured_pictures
from rfpipe.transport import Transport, open_transport
from rfpipe.units import SYMMETRY_BRACKETS

if TYPE_CHECKING:
    import pandas as pd

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AcquisitionResult:
    """Result of an acquisition in process.

    Attributes
    ----------
    transport : Transport
    picture_counts : PictureCounts
        Pictures on the rig by purpose: patterns, references, symmetry test, check pictures and
        verification; and their exposures.
    capture_seconds, processing_seconds : float
        Wall time of captures, and of everything else.
    saturated : int
        Samples that were saturated in every exposure; 0 in a well exposed acquisition.
    masked : ndarray of bool, shape (*camera_shape)
        Camera rays that were left out, since they are dead or hot.
    verification : Verification or None
        Errors of the transport on pictures that the method didn't see, if any were taken;
        ``verification.table`` has one row per picture.
    """

    transport: Transport
    picture_counts: PictureCounts
    capture_seconds: float
    processing_seconds: float
    saturated: int
    masked: NDArray[np.bool_]
    verification: Verification | None = None

    def __repr__(self) -> str:
        return (
            f"AcquisitionResult({self.patterns} patterns, {self.pictures} pictures on the rig, "
            f"{self.seconds:.3g} s, {self.transport})"
        )

    @property
    def patterns(self) -> int:
        """Patterns of all levels of the method, as the thesis counts them."""
        return self.picture_counts.patterns

    @property
    def pictures(self) -> int:
        """Pictures on the rig for all purposes, one bracket each."""
        return self.picture_counts.total

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
    method: str | MethodDescription = "symmetric",
    *,
    prior: Transport | str | Path | None = None,
    progress: bool = True,
    all_off_brackets: int | None = None,
    all_on_brackets: int | None = None,
    symmetry_brackets: int = SYMMETRY_BRACKETS,
    asymmetry: float = 0.05,
    mask_defects: bool = True,
    watch: WatchMode | None = None,
    divide_out_drift: bool | None = None,
    verification: int | None = None,
    **options: Any,
) -> AcquisitionResult:
    """Acquire the transport between a rig's projector and camera.

    Ctrl-C ends it with the transport of the levels so far, if level 0 is complete.

    Parameters
    ----------
    rig : Rig
    method : str or MethodDescription
        A name in `rfpipe.methods.method_names`, the path of your own class as
        ``module:Class`` or ``file.py:Class``, or a method itself.
    prior : Transport or path, optional
        Transport of the same rig, of an earlier acquisition of this or a similar scene, or its
        store. Three pictures show whether it meets the target or helps to; otherwise it is dropped.
        Whether the rig is coaxial is then not measured: the prior shows it.
    progress : bool
        Whether to show progress bars of captures and fits on stderr.
    all_off_brackets : int, optional
        Number of all-off brackets, whose mean is subtracted; at least 1. None: as many as the
        target error needs. Exact radiance takes one.
    all_on_brackets : int, optional
        Number of all-on brackets, to whose mean each level's images are scaled; at least 1. None:
        as many as the target error needs. Exact radiance takes one.
    symmetry_brackets : int
        Number of brackets of random patterns that measure whether the rig is coaxial, for methods
        that depend on it; at least 3, or 0 not to measure it.
    asymmetry : float
        Accepted error in relit pictures, relative to their norm, of treating the rig as coaxial.
    mask_defects : bool
        Whether dead and hot pixels are masked. On a coaxial rig their rows of T are filled from
        their columns; on other rigs the rows are zero.
    watch : {"off", "warn", "refuse"}, optional
        Reaction to pictures that show that the rig or its light changed: "refuse" raises
        CaptureError. None: "refuse", "off" with a simulated rig.
    divide_out_drift : bool, optional
        Whether images are divided by the lamp's brightness. None: with rigs that aren't simulated.
    verification : int, optional
        Number of pictures that verify the transport, taken afterwards; 0 for none. None: 9, 0 with
        a simulated rig.
    **options
        The method's own: its ``Options``, such as ``tolerance`` of "symmetric" and "dual", or
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
        If the rig fails or returns invalid pictures, if the method needs a coaxial rig and the rig
        isn't coaxial, or if the rig or its light changes and `watch` is "refuse".
    """
    if not hasattr(rig, "capture"):
        raise InputError(
            f"{type(rig).__name__} can't capture",
            remedy="make a rig of a matrix or linear operator: rfpipe.OperatorRig(matrix, "
            "camera_shape=(h, w), projector_shape=(h, w))",
        )
    precautions = PRECAUTIONS["simulated" if is_simulated(rig) else "remote"]
    watch = precautions.watch if watch is None else watch
    if verification is None:
        verification = precautions.verification_pictures
    if divide_out_drift is None:
        divide_out_drift = precautions.divide_out_drift
    _check(all_off_brackets, all_on_brackets, symmetry_brackets, verification, watch)
    began = perf_counter()
    description, storage = get_method(method), MemoryStorage()
    rays = rig.camera_shape, rig.projector_shape, rig.channels
    if isinstance(prior, str | Path):
        prior = open_transport(prior)
    plan = Plan.of(description.name, description, rays, options, asymmetry, prior)
    settings = AcquisitionSettings(
        all_off_brackets=all_off_brackets,
        all_on_brackets=all_on_brackets,
        target_error=plan.target_error,
        expected_patterns=plan.expected_patterns,
        symmetry_brackets=symmetry_brackets if plan.measures_symmetry else 0,
        # a simulated rig has no interval; a caller who sets `watch` gets check pictures even so
        check_interval=precautions.check_interval or PRECAUTIONS["remote"].check_interval,
        seconds_per_pattern=rig.seconds_per_pattern,
        watch=watch,
        accepted_asymmetry=asymmetry,
        mask_defects=mask_defects,
        divide_out_drift=divide_out_drift,
        progress=progress,
    )
    acquisition = Acquisition(
        storage, settings, rig_source=GivenRig(rig), sensor=rig.sensor, plan=plan
    )
    try:
        for finished in acquire_levels(acquisition):
            acquisition = finished
    except KeyboardInterrupt:
        if acquisition.state is None:
            raise
        _log.warning("stopped: the transport of the levels so far is returned")
        verification = 0
    return _result(acquisition, storage, began, verification)


def _result(
    acquisition: Acquisition, storage: MemoryStorage, began: float, verification: int
) -> AcquisitionResult:
    """Assemble the transport and, with a number of pictures, verify it."""
    levels = len(acquisition.state.rows)
    transport, masked = assembled(acquisition, levels)
    verified = _verified(acquisition, transport, verification) if verification else None
    merged = [storage.read_manifest(level, "merge") for level in range(levels)]
    return AcquisitionResult(
        transport,
        captured_pictures(storage, levels - 1),
        storage.seconds["capture"],
        perf_counter() - began - storage.seconds["capture"],
        sum(facts["saturated"] for facts in merged),
        masked,
        verified,
    )


def _verified(acquisition: Acquisition, transport: Transport, pictures: int) -> Verification:
    """Capture pictures that verify the transport; log a missed target."""
    storage, plan = acquisition.storage, acquisition.plan
    schedule = verification_schedule(plan.projector.shape, pictures)
    write_schedule(storage, VERIFICATION, "", schedule)
    context = verification_context(acquisition, pictures)
    with storage.timing(VERIFICATION, "capture"):
        capture.run(context, VERIFICATION)
    merge.run(context, VERIFICATION)
    verified = verify(storage, transport)
    outcome = verified.against(plan.options.error_target)
    if outcome.verdict == "missed":
        _log.warning("the target is missed: %s", outcome.reason)
    return verified


def _check(
    all_off_brackets: int | None,
    all_on_brackets: int | None,
    symmetry_brackets: int,
    verification: int,
    watch: str,
) -> None:
    """Raise InputError for arguments of `acquire` that are out of range."""
    given = [count for count in (all_off_brackets, all_on_brackets) if count is not None]
    if min(given, default=1) < 1:
        raise InputError(
            f"all_off_brackets is {all_off_brackets} and all_on_brackets {all_on_brackets}; "
            "at least one of each is needed"
        )
    if symmetry_brackets < 0 or symmetry_brackets in (1, 2):
        raise InputError(f"symmetry_brackets is {symmetry_brackets}; 0, or 3 or more, are needed")
    if watch not in get_args(WatchMode):
        raise InputError(f"watch is {watch!r}; expected one of {', '.join(get_args(WatchMode))}")
    if verification < 0:
        raise InputError(f"verification is {verification}; 0 or more pictures can be taken")
