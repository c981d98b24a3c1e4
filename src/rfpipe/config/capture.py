"""A run's pictures, how they are taken and what is made of them: a group of settings each."""

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
    setting,
)
from rfpipe.units import NumberFormat

Batch = Annotated[int, Field(ge=1, le=1024)]
Command = Annotated[str, AfterValidator(check_command)]
Normalization = Literal["none", "per_channel", "total_energy"]


RigKind = Literal["simulated", "remote", "offline"]
Watch = Literal["off", "warn", "refuse"]


class Precautions(NamedTuple):
    """Defaults by which a kind of rig is watched and verified.

    Attributes
    ----------
    watch : {"off", "warn", "refuse"}
        What to do where pictures show that the rig or its light changed.
    check_interval : int
        Patterns from one check picture to the next, 0 for no check pictures.
    verification_pictures : int
        Pictures that verify a transport, 0 for none.
    divide_out_drift : bool
        Whether images are divided by the brightness of the lamp.
    """

    watch: Watch
    check_interval: int
    verification_pictures: int
    divide_out_drift: bool


PRECAUTIONS: dict[RigKind, Precautions] = {
    "simulated": Precautions("off", 0, 0, False),
    "remote": Precautions("refuse", 8, 9, True),
    # pictures that are taken by hand: one of each kind, and no repeated pattern
    "offline": Precautions("refuse", 0, 3, False),
}
"""Precautions by the kind of rig, for runs and for `rfpipe.acquire`; any real rig is "remote"."""


class CaptureConfig(Settings):
    """How patterns are shown and pictures taken."""

    rig: RigKind = setting(
        "simulated",
        "The rig: simulated; remote, behind 'rfpipe serve'; or offline, by 'rfpipe patterns' and "
        "'rfpipe import'.",
    )
    url: Annotated[str, AfterValidator(check_server)] = setting(
        "http://127.0.0.1:8750", "Address of the acquisition server."
    )
    token_file: Text | None = setting(
        None,
        "File with the server's token, readable by its owner alone; null: RFPIPE_TOKEN.",
    )
    patience_seconds: float = setting(
        600.0, "Wait for a server or rig that fails, in seconds.", ge=0, le=604_800
    )
    placing: Command | None = setting(
        None, "Command that puts the scene named in RFPIPE_SCENE before the rig, or null."
    )
    seconds_per_pattern: float = setting(
        2.0, "Seconds of a pattern's bracket on a real rig, for forecasts.", gt=0, le=3600
    )
    black_frames: Batch = setting(8, "Brackets of the all-off pattern, averaged: 1 to 1024.")
    floodlit_frames: Batch = setting(
        64, "Brackets of all-on, averaged, which set the direct light's noise: 1 to 1024."
    )
    asymmetry: Fraction = setting(
        0.05, "Relative error in relit pictures above which a rig isn't taken for a coaxial one."
    )
    watch: Watch = setting(
        "refuse",
        "Where pictures show that the rig or its light changed: refuse ends the capture; off: no "
        "check pictures.",
    )
    batch_patterns: Batch = setting(16, "Patterns captured and stored at a time, 1 to 1024.")
    keep_raw: bool = setting(
        True, "Whether raw exposures stay; else another merge means another capture."
    )
    warm_up_minutes: float = setting(
        0.0, "Minutes of white before a capture whose lamp may be cold.", ge=0, le=240
    )
    when_patterns_change: Literal["recapture", "refuse"] = setting(
        "recapture", "What to do with pictures whose patterns other settings have changed."
    )

    @property
    def rule(self) -> Literal["simulated", "hardware", "offline"]:
        """Which of the workflow's rules of capture."""
        return "hardware" if self.rig == "remote" else self.rig

    @property
    def precautions(self) -> Precautions:
        """Defaults for this kind of rig."""
        return PRECAUTIONS[self.rig]


class OfflineConfig(Settings):
    """A rig whose pictures come and go as files, with capture.rig offline."""

    projector_shape: tuple[Extent, Extent] | None = setting(
        None, "Height and width of the pictures to show; null: the calibration's, or a pixel a ray."
    )
    projector_gamma: Gamma = setting(
        2.2, "Exponent g of the projector, light ~ code^g, above 0 and at most 5."
    )
    picture_shape: tuple[Extent, Extent] | None = setting(
        None, "Height and width of the camera's pictures in pixels, with camera_corners."
    )
    camera_corners: Corners | None = setting(
        None,
        "Corners of each view's rays in the pictures, in pixels, from the upper left one "
        "clockwise; null: the calibration's, or a pixel a ray.",
    )
    calibration: Text | None = setting(
        None, "Folder of a calibration, relative to where rfpipe runs, or null."
    )

    @model_validator(mode="after")
    def _knows_the_picture(self) -> Self:
        if (self.picture_shape is None) != (self.camera_corners is None):
            raise ValueError("picture_shape and camera_corners should both be set, or be null")
        return self


class VerificationConfig(Settings):
    """Pictures that no method saw, taken after an acquisition to compare the transport with."""

    pictures: int | None = setting(
        None,
        "How many; null: 9 by a real rig, 3 by an offline one, none by a simulated one.",
        ge=0,
        le=96,
    )
    fail_above: Fraction | None = setting(
        None,
        "Mean relative error of these pictures above which the run fails; null: by a real rig 1.5 "
        "times the method's target_error, else never.",
    )


class MergeConfig(Settings):
    """How a bracket becomes a radiance image."""

    mask_defects: bool = setting(
        True, "Whether dead and hot pixels are left out, with an infinite variance."
    )
    divide_out_drift: bool | None = setting(
        None,
        "Whether images are divided by the lamp's brightness, which check pictures measure; "
        "null: of a real rig.",
    )


class ResourcesConfig(Settings):
    """What a job may use; none of it changes a result."""

    memory_gib: float = setting(4.0, "Memory that a job may take, in GiB.", ge=0.5, le=1024)
    workers: Annotated[str, AfterValidator(check_workers)] = setting(
        THREADS, "threads, or the address of a dask scheduler, tls://host:8786 (docs/parallel.md)."
    )
    jobs: Literal["stage", "acquisition"] | None = setting(
        None,
        "A job's work; null: acquisition with a collection, capture.placing or scenes of at most "
        "4,000 rays, else stage.",
    )
    captures: Literal["here", "job"] = setting(
        "here",
        "Where jobs of a real rig run: beside Snakemake, or as a cluster's (docs/clusters.md).",
    )


class StorageConfig(Settings):
    """How the transport is stored."""

    number_format: NumberFormat = setting(
        "uint8",
        "How numbers are kept: float32 as they are; uint16, uint8 within about 1e-5, 3e-3.",
    )
    keep_at: Annotated[str, AfterValidator(check_bucket)] | None = setting(
        None, "Folder in a bucket, of this run alone, that keeps its results (docs/stores.md)."
    )


class ReportConfig(Settings):
    """What the report shows."""

    page: bool | None = setting(
        None, "Whether a run ends with a report; null: unless its collection has a catalogue."
    )
    title: Text | None = setting(
        None, "The report's title; null: Light transport, of as many scenes as it has."
    )
