"""The settings of the thesis' figures on physically based scenes."""

from __future__ import annotations

from pydantic import Field

from rfpipe.config.base import Extent, Settings, Text

__all__ = ["FiguresConfig"]


class FiguresConfig(Settings):
    """The thesis' figures on physically based scenes, which need the extra mitsuba."""

    side: Extent = Field(48, description="Sides of the square pictures, in pixels, 1 to 4096.")
    samples: int = Field(
        4096, ge=2, le=2**20, description="Paths of light a pixel, 2 to 1,048,576."
    )
    positions: int = Field(
        80, ge=1, le=1024, description="Camera positions of the 6D field [Fig. 3.9], 1 to 1024."
    )
    cache: Text = Field(
        "results/recorded",
        description="Folder that recorded matrices are kept in, relative to the working folder.",
    )
