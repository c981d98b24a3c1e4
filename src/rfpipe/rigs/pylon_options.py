"""What a Basler camera may be told."""

from __future__ import annotations

from pydantic import Field

from rfpipe.rigs.cameras.options import GenicamOptions

__all__ = ["PylonOptions"]


class PylonOptions(GenicamOptions):
    """A Basler camera."""

    sequence_line: str | None = Field(
        None,
        min_length=1,
        description="Input at which a projector with sequences triggers the camera, as its manual "
        "names it, such as Line1; null where there is no such projector.",
    )
