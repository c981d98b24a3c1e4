"""The configuration's part that `rfpipe.stages.acquire.acquire` takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.config.base import MethodSettings

__all__ = ["acquire_options"]

_CAPTURE = ("black_frames", "floodlit_frames", "symmetry_frames", "asymmetry")


def acquire_options(config: Config, name: str, section: MethodSettings) -> dict[str, Any]:
    """Return keyword arguments of `acquire` for a method's section of this name."""
    return {
        "method": section.method or name,
        **section.options(),
        **config.capture.model_dump(include=set(_CAPTURE)),
        **config.merge.model_dump(exclude={"divide_out_drift"}),  # in process none is watched
        "normalization": config.normalization,
    }
