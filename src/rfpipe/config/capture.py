"""Settings of a run's pictures: capture, merge, verification, storage and report."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from rfpipe.config.addresses import THREADS, check_bucket, check_server, check_workers
from rfpipe.config.base import (
    Corners,
    Extent,
    Fraction,
    Gamma,
    Settings,
    Text,
    check_command,
)
from rfpipe.units import NumberFormat

Batch = Annotated[int, Field(ge=1, le=1024)]
ShellCommand = Annotated[str, AfterValidator(check_command)]
CaptureKind = Literal["simulated", "remote", "offline"]
WatchMode = Literal["off", "warn", "refuse"]


class Precautions(NamedTuple):
    """Defaults of the checks on a kind of rig.

    Attributes
    ----------
    watch : {"off", "warn", "refuse"}
        Reaction to pictures which show that the rig or its light changed.
    check_interval : int
        Patterns from one check picture to the next, 0 for no check pictures.
    verification_pictures : int
        Pictures that verify a transport, 0 for none.
    divide_out_drift : bool
        Divide images by the brightness of the lamp.
    all_off_brackets, all_on_brackets : int or None
        Number of reference brackets; None: as many as the target error needs.
    """

    watch: WatchMode
    check_interval: int
    verification_pictures: int
    divide_out_drift: bool
    all_off_brackets: int | None = None
    all_on_brackets: int | None = None


PRECAUTIONS: dict[CaptureKind, Precautions] = {
    "simulated": Precautions("off", 0, 0, False),
    "remote": Precautions("refuse", 16, 9, True),
    # somebody takes these pictures by hand, so no pattern is repeated between others, and all
    # reference brackets are on the first list
    "offline": Precautions("refuse", 0, 3, False, 2, 6),
}
"""Precautions by the kind of rig, for runs and for `rfpipe.acquire`; any real rig is "remote"."""


class CaptureConfig(Settings):
    """Display of the patterns and capture of the pictures."""

    rig: CaptureKind = Field(
        "simulated",
        description="The rig: simulated; remote, a rig behind 'rfpipe serve'; or offline, with "
        "files from 'rfpipe patterns' and 'rfpipe import'.",
    )
    url: Annotated[str, AfterValidator(check_server)] = Field(
        "http://127.0.0.1:8750", description="Address of the acquisition server."
    )
    token_file: Text | None = Field(
        None,
        description="File with the server's token, readable only by its owner; null: the "
        "environment variable RFPIPE_TOKEN.",
    )
    patience_seconds: float = Field(
        600.0,
        description="Seconds to wait for a server or rig that fails.",
        ge=0,
        le=604_800,
    )
    placing: ShellCommand | None = Field(
        None,
        description="Command that puts the scene named in RFPIPE_SCENE in front of the rig; null: "
        "none.",
    )
    seconds_per_pattern: float = Field(
        2.0,
        description="Seconds that a real rig needs for the bracket of a pattern, for forecasts.",
        gt=0,
        le=3600,
    )
    all_off_brackets: Batch | None = Field(
        None,
        description="Brackets of the all-off pattern to average; null: as many as the target "
        "error needs, 2 of an offline rig.",
    )
    all_on_brackets: Batch | None = Field(
        None,
        description="Brackets of the all-on pattern to average; they limit the noise of the "
        "direct light. null: as many as the target error needs, 6 of an offline rig.",
    )
    asymmetry: Fraction = Field(
        0.05,
        description="Relative error in relit pictures above which a rig doesn't count as coaxial.",
    )
    watch: WatchMode = Field(
        "refuse",
        description="Reaction to pictures which show that the rig or its light changed: refuse "
        "ends the capture, warn logs it, off takes no check pictures.",
    )
    batch_patterns: Batch = Field(
        16, description="Patterns that are captured before they are stored together."
    )
    keep_raw: bool = Field(
        True,
        description="Keep the brackets, the raw exposures; without them, other settings of merge "
        "need a new capture.",
    )
    warm_up_minutes: float = Field(
        0.0,
        description="Minutes of white light before a capture for which the lamp may be cold.",
        ge=0,
        le=240,
    )
    when_patterns_change: Literal["recapture", "refuse"] = Field(
        "recapture",
        description="Reaction to changed settings that need other patterns than those captured: "
        "recapture, or refuse to run.",
    )

    @property
    def rule(self) -> Literal["simulated", "hardware", "offline"]:
        """Suffix of the workflow's rule that captures."""
        return "hardware" if self.rig == "remote" else self.rig

    @property
    def precautions(self) -> Precautions:
        """Default precautions for this kind of rig."""
        return PRECAUTIONS[self.rig]


class OfflineConfig(Settings):
    """Files of an offline rig (capture.rig offline)."""

    projector_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the patterns' files in pixels; null: from the "
        "calibration, or a pixel per ray.",
    )
    projector_gamma: Gamma = Field(2.2, description="Exponent g of the projector, light ~ code^g.")
    picture_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the camera's pictures in pixels; needed with "
        "camera_corners.",
    )
    camera_corners: Corners | None = Field(
        None,
        description="Corners (x, y) of each view's rays in the pictures, in pixels, clockwise "
        "from the upper left; null: from the calibration, or a pixel per ray.",
    )
    calibration: Text | None = Field(
        None,
        description="Folder of a calibration, relative to the folder where rfpipe runs; null: "
        "none.",
    )

    @model_validator(mode="after")
    def _check_picture_shape(self) -> Self:
        if (self.picture_shape is None) != (self.camera_corners is None):
            raise ValueError("picture_shape and camera_corners should both be set, or be null")
        return self


class VerificationConfig(Settings):
    """Verification of a transport by pictures that no method used."""

    pictures: int | None = Field(
        None,
        description="Number of verification pictures; null: 9 for a remote rig, 3 for an offline "
        "one, 0 for a simulated one.",
        ge=0,
        le=96,
    )
    fail_above: Fraction | None = Field(
        None,
        description="Mean relative error of the verification pictures above which the run fails; "
        "null: 1.5 times the method's target_error for a real rig, no limit for a simulated one.",
    )


class MergeConfig(Settings):
    """Merge of a bracket into a radiance image."""

    mask_defects: bool = Field(
        True, description="Exclude dead and hot pixels by giving them infinite variance."
    )
    divide_out_drift: bool | None = Field(
        None,
        description="Divide images by the lamp's brightness, which check pictures measure; null: "
        "only for a remote rig.",
    )


class ResourcesConfig(Settings):
    """Resources of a job; they change no result."""

    memory_gib: float = Field(
        4.0, description="Memory that a job may use, in GiB.", ge=0.5, le=1024
    )
    workers: Annotated[str, AfterValidator(check_workers)] = Field(
        THREADS,
        description="threads, or the address of a dask scheduler, such as tls://host:8786 "
        "(docs/parallel.md).",
    )
    jobs: Literal["stage", "acquisition"] | None = Field(
        None,
        description="Work of one job: a stage or an acquisition; null: an acquisition with a "
        "collection, with capture.placing, or if no scene has more than 4,000 rays, else a stage.",
    )
    captures: Literal["here", "job"] = Field(
        "here",
        description="Where the captures of a real rig run: here, on the machine of Snakemake, or "
        "as a job of the cluster (docs/clusters.md).",
    )


class StorageConfig(Settings):
    """Storage of the transport."""

    number_format: NumberFormat = Field(
        "uint8",
        description="Format of stored numbers: float32 is exact; uint16 and uint8 have relative "
        "errors of about 1e-5 and 3e-3.",
    )
    keep_at: Annotated[str, AfterValidator(check_bucket)] | None = Field(
        None,
        description="Folder in a bucket, used by this run only, to which results are copied "
        "(docs/stores.md); null: none.",
    )


class ReportConfig(Settings):
    """The report of a run."""

    page: bool | None = Field(
        None,
        description="Write a report at the end of the run; null: only without a collection, "
        "which has a catalogue.",
    )
    title: Text | None = Field(
        None, description="Title of the report; null: Light transport of the scene or scenes."
    )
