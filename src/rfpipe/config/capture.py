"""How a run's pictures are taken: capture, offline rigs, verification."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from rfpipe.config.addresses import check_server
from rfpipe.config.base import Corners, Extent, Fraction, Gamma, Settings, Text, check_command

Batch = Annotated[int, Field(ge=1, le=1024)]


class CaptureConfig(Settings):
    """How patterns are shown and pictures taken."""

    rig: Literal["simulated", "remote", "offline"] = Field(
        "simulated",
        description="The rig: simulated; remote, behind 'rfpipe serve'; or offline, by 'rfpipe "
        "patterns' and 'rfpipe import'.",
    )
    url: str = Field(
        "http://127.0.0.1:8750",
        description="Address of the acquisition server, such as http://127.0.0.1:8750.",
    )
    token_file: Text | None = Field(
        None,
        description="File with the server's token, readable by its owner alone; null: the "
        "environment variable RFPIPE_TOKEN.",
    )
    patience_seconds: float = Field(
        600.0,
        ge=0,
        le=604_800,
        description="Wait for a server or rig that fails, in seconds, 0 to 604800.",
    )
    placing: Text | None = Field(
        None,
        description="Command that puts the scene named in RFPIPE_SCENE before the rig; null: it "
        "stands there.",
    )
    seconds_per_pattern: float = Field(
        2.0,
        gt=0,
        le=3600,
        description="Seconds of a pattern's bracket on a real rig, for forecasts, above 0 and "
        "at most 3600.",
    )
    black_frames: Batch = Field(
        8, description="Brackets of the all-off pattern, averaged: 1 to 1024."
    )
    floodlit_frames: Batch = Field(
        64,
        description="Brackets of the all-on pattern, averaged, which set the noise of the direct "
        "light: 1 to 1024.",
    )
    share_references: Literal["none", "black", "all"] | None = Field(
        None,
        description="Brackets taken once for many acquisitions: black, all or none; null: "
        "black with a collection.",
    )
    asymmetry: Fraction = Field(
        0.05,
        description="Error in relit pictures, a fraction of their norm, above which a rig isn't "
        "taken for a coaxial one.",
    )
    watch: Literal["off", "warn", "refuse"] = Field(
        "warn",
        description="When pictures tell that the rig moved or isn't aligned: warn, refuse (end the "
        "capture) or off (not looked at).",
    )
    batch_patterns: Batch = Field(
        16, description="Patterns captured and stored at a time, 1 to 1024."
    )
    keep_raw: bool = Field(
        True,
        description="Whether raw exposures stay after their merge; without them, other merge "
        "settings mean to capture again.",
    )
    warm_up_minutes: float = Field(
        0.0,
        ge=0,
        le=240,
        description="Minutes of white before a capture whose lamp may be cold, 0 to 240.",
    )
    drift_minutes: float | None = Field(
        None,
        gt=0,
        le=1440,
        description="Minutes between two looks at the floodlit image, above 0 and at most 1440; "
        "null: none.",
    )
    when_patterns_change: Literal["recapture", "refuse"] = Field(
        "recapture",
        description="What to do with a level's pictures when other settings change its patterns: "
        "recapture or refuse.",
    )

    @field_validator("url")
    @classmethod
    def _is_of_a_server(cls, url: str) -> str:
        check_server(url)
        return url

    @field_validator("placing")
    @classmethod
    def _places_by_a_command(cls, command: str | None) -> str | None:
        return check_command(command)

    @property
    def rule(self) -> Literal["simulated", "hardware", "offline"]:
        """Which of the workflow's rules of capture."""
        return "hardware" if self.rig == "remote" else self.rig

    @property
    def looks(self) -> int | None:
        """Patterns from one look at the rig to the next, 0 for none; None: by the method."""
        return None if self.rig == "remote" else 0

    @property
    def drift_patterns(self) -> int:
        """Patterns from one look at the floodlit image to the next, 0 for no looks.

        Counted, not timed: a capture that was resumed has the looks of one that ran through.
        """
        if self.drift_minutes is None:
            return 0
        return max(1, round(60 * self.drift_minutes / self.seconds_per_pattern))


class OfflineConfig(Settings):
    """A rig whose pictures come and go as files, with capture.rig offline."""

    projector_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the pictures to show, 1 to 4096 each; null: the "
        "calibration's, or a pixel a ray.",
    )
    projector_gamma: Gamma = Field(
        2.2, description="Exponent g of the projector, light ~ code^g, above 0 and at most 5."
    )
    picture_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the camera's pictures in pixels, 1 to 4096 each, where "
        "camera_corners are set.",
    )
    camera_corners: Corners | None = Field(
        None,
        description="Corners of each view's rays in the pictures, in pixels, from the upper "
        "left one clockwise; null: the calibration's, or a pixel a ray.",
    )
    calibration: Text | None = Field(
        None, description="Folder of a calibration, relative to where rfpipe runs, or null."
    )

    @model_validator(mode="after")
    def _knows_the_picture(self) -> Self:
        if (self.picture_shape is None) != (self.camera_corners is None):
            raise ValueError(
                "picture_shape and camera_corners should be set together, or both be null"
            )
        return self


class VerificationConfig(Settings):
    """Pictures that no method saw, taken after an acquisition to compare the transport with."""

    pictures: Annotated[int, Field(ge=0, le=10)] | None = Field(
        None, description="How many, 0 to 10; null: 8 by a real rig, none by another."
    )
    fail_above: Fraction | None = Field(
        None,
        description="Mean error of these pictures, a fraction of their norm, above which the "
        "run fails; null: never.",
    )
