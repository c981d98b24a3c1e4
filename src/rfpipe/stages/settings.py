"""The configuration's part that `rfpipe.stages.acquire.acquire` takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["acquire_options"]


def acquire_options(config: Config) -> dict[str, Any]:
    """Return keyword arguments of `acquire`, all but the tolerance."""
    return {
        **config.acquisition.model_dump(exclude={"tolerance"}),
        **config.capture.model_dump(include={"black_frames", "floodlit_frames"}),
        **config.merge.model_dump(exclude={"divide_out_drift"}),  # in process none is watched
        "normalization": config.normalization,
    }
