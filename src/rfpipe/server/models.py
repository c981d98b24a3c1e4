"""What the server's JSON requests and answers hold."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = [
    "Health",
    "LeaseAnswer",
    "LeaseRequest",
    "Limits",
    "Metrics",
    "RigAnswer",
    "StatusAnswer",
]


class Health(BaseModel):
    """That the server is there."""

    status: Literal["ok", "stopping"]
    version: str = Field(description="Version of rfpipe.")
    api: int = Field(description="Version of this interface.")


class Metrics(BaseModel):
    """What happened since the start."""

    brackets: int = Field(0, description="Patterns exposed.")
    answered_again: int = Field(
        0, description="Requests that came again and were answered without a new exposure."
    )
    failures: int = Field(0, description="Exposures that ended with an error of the rig.")
    last_error: str | None = None
    exposing_seconds: float = Field(0.0, description="Time that the rig took for all brackets.")


class StatusAnswer(Metrics):
    """Who holds the rig, and what happened since the start."""

    up_seconds: float
    holder: str | None = Field(description="What the client that holds the rig calls itself.")
    devices: dict[str, dict[str, int]] = Field(
        default_factory=dict,
        description="What the rig's devices counted, such as failed frames, of those that count.",
    )


class Limits(BaseModel):
    """What a client has to keep to."""

    patterns: int = Field(description="Patterns in a request.")
    request_bytes: int = Field(description="Bytes of a request's body.")
    lease_seconds: float = Field(description="Time that a lease lasts without a heart-beat.")


class RigAnswer(BaseModel):
    """The rig, as `rfpipe.rigs.Rig` has it."""

    camera_shape: list[int]
    projector_shape: list[int]
    channels: int
    seconds_per_pattern: float
    sensor: dict[str, Any] = Field(description="The sensor's description.")
    has_arrays: bool = Field(description="Whether the sensor needs /v1/rig/arrays, too.")
    description: dict[str, Any] = Field(description="All that shapes a frame.")
    digest: str = Field(description="Fingerprint of the description.")
    limits: Limits


class LeaseRequest(BaseModel):
    """Who wants the rig."""

    model_config = ConfigDict(extra="forbid")

    client: str = Field(
        min_length=1, max_length=100, pattern=r"^[ -~]+$", description="A name for people to read."
    )


class LeaseAnswer(BaseModel):
    """The right to use the rig."""

    lease: str = Field(description="To be sent as the header Rig-Lease, and told to nobody.")
    seconds: float = Field(description="Time that it lasts without a heart-beat.")
