"""What the projector's window may be told."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from rfpipe.config.base import Settings

__all__ = ["WindowOptions"]

Offset = Annotated[int, Field(ge=0, le=32768)]
PictureExtent = Annotated[int, Field(ge=1, le=32768)]


class WindowOptions(Settings):
    """The projector: a full-screen window on a display."""

    display: str | None = Field(
        None,
        pattern=r"^\S*:\d+(\.\d+)?$",
        description="X display, such as :0, or null for that of the environment's DISPLAY.",
    )
    screen: int = Field(
        0, ge=0, le=63, description="Number of the monitor on that display, 0 to 63."
    )
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the picture on the monitor: pixels from its upper edge and from "
        "its left edge.",
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None,
        description="Height and width of the picture in pixels, or null for the whole monitor. "
        "Set the monitor to the projector's native resolution.",
    )
    settle_seconds: float = Field(
        0.1,
        ge=0,
        le=60,
        description="Wait after a picture was drawn, until the projector shows it, in seconds, 0 "
        "to 60: two or three frames of the display plus the projector's own delay.",
    )
    reopen_seconds: float = Field(
        10.0,
        ge=0,
        le=3600,
        description="How long to try to open the window again when its display is lost, as by a "
        "cable that flickers or an X server that is started again, in seconds, 0 to 3600. A "
        "client of the server that serves the rig then waits for up to capture.patience_seconds.",
    )
    response: str | None = Field(
        None,
        description="Text file with the light of the codes 0 to 255, one number a line, as a "
        "fraction of that of 255; null for that of the calibration, or, without one, light in "
        "proportion to the code.",
    )
