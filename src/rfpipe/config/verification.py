"""The settings of a verification."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from rfpipe.config.base import Fraction, Settings

__all__ = ["VerificationConfig"]


class VerificationConfig(Settings):
    """Pictures that no method saw, taken after an acquisition to compare the transport with."""

    pictures: Annotated[int, Field(ge=0, le=10)] | None = Field(
        None,
        description="How many, 0 (none) to 10, such as a natural picture, stripes and scattered "
        "spots; null: 8 by a real rig, none by a simulated or an offline one.",
    )
    fail_above: Fraction | None = Field(
        None,
        description="Mean error of these pictures relit, as a fraction of their norm between 0 and "
        "1, above which the run fails once its report is written; null: it doesn't.",
    )
