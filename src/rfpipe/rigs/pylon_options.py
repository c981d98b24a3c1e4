"""What a Basler camera may be told."""

from __future__ import annotations

from rfpipe.rigs.cameras.options import GenicamOptions

__all__ = ["PylonOptions"]


class PylonOptions(GenicamOptions):
    """A Basler camera."""
