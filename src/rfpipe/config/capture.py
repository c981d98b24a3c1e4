"""How a run's pictures are taken: the settings of its section ``capture``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from rfpipe.config.addresses import check_server
from rfpipe.config.base import Fraction, Settings, Text, check_command

SYMMETRY_FRAMES = 6  # four say the same within 20 %, eight within 10 %
"""Random patterns that tell whether a rig is coaxial."""

Batch = Annotated[int, Field(ge=1, le=1024)]


class CaptureConfig(Settings):
    """How patterns are shown and pictures taken."""

    rig: Literal["simulated", "remote", "offline"] = Field(
        "simulated",
        description="The rig: simulated; remote, behind an acquisition server ('rfpipe serve'); or "
        "offline, whose pictures are taken elsewhere ('rfpipe patterns', 'rfpipe import').",
    )
    url: str = Field(
        "http://127.0.0.1:8750",
        pattern=r"^https?://[^\s/]+/?$",
        description="Address of the acquisition server, such as http://127.0.0.1:8750.",
    )
    token_file: Text | None = Field(
        None,
        description="File with the server's token, readable by its owner alone, or null for the "
        "environment variable RFPIPE_TOKEN.",
    )
    patience_seconds: float = Field(
        600.0,
        ge=0,
        le=604_800,
        description="How long to wait for a server that doesn't answer, or for a rig that fails, "
        "before the run ends, in seconds, 0 to 604800, a week.",
    )
    placing: Text | None = Field(
        None,
        description="Command that puts a scene before the rig, such as one that moves a gantry or "
        "waits until somebody says that the object stands there; it finds the scene's name in "
        "RFPIPE_SCENE, and runs again when an acquisition goes on. null: the scene stands there.",
    )
    seconds_per_pattern: float = Field(
        2.0,
        gt=0,
        le=3600,
        description="Time that a real rig takes for a pattern's bracket, in seconds, above 0 and "
        "at most 3600; the simulation doesn't wait, reports count with it.",
    )
    black_frames: Batch = Field(
        8, description="Brackets of the all-off pattern, averaged: 1 to 1024."
    )
    floodlit_frames: Batch = Field(
        64,
        description="Brackets of the all-on pattern, averaged: 1 to 1024. A level's images are "
        "scaled to them, so that they set the noise of the direct light.",
    )
    share_references: Literal["none", "black", "all"] | None = Field(
        None,
        description="Which of these are taken once for many: black (all-off ones, once for all "
        "acquisitions by a rig), all (the all-on ones of a scene as well, once for all its "
        "methods) or none; null: black with a collection, else none.",
    )
    asymmetry: Fraction = Field(
        0.05,
        description="Error in relit pictures, as a fraction of their norm between 0 and 1, that "
        "taking the rig for a coaxial one may make; above it, the acquisition ends.",
    )
    watch: Literal["off", "warn", "refuse"] = Field(
        "warn",
        description="What to do when pictures tell that the rig moved, or that a coaxial one isn't "
        "aligned: warn, refuse (end the capture), or off (not looked at).",
    )
    batch_patterns: Batch = Field(
        16, description="Patterns captured and stored at a time, 1 to 1024."
    )
    keep_raw: bool = Field(
        True,
        description="Whether a level's raw exposures stay after their merge: true or false. "
        "Without them, other merge settings mean to capture again.",
    )
    warm_up_minutes: float = Field(
        0.0,
        ge=0,
        le=240,
        description="Time for which the projector shows white before a capture, when no bracket "
        "was taken for as long: 0 (none) to 240 minutes. A simulated lamp waits, too.",
    )
    drift_minutes: float | None = Field(
        None,
        gt=0,
        le=1440,
        description="Time between two looks at the floodlit image during a level, above 0 and at "
        "most 1440 minutes, or null for none: what the lamp drifts by is reported.",
    )
    when_patterns_change: Literal["recapture", "refuse"] = Field(
        "recapture",
        description="What to do with a level's pictures when a changed setting changes its "
        "patterns: recapture (it says so first) or refuse.",
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
