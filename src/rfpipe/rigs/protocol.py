"""What the acquisition server and its client say to each other beside patterns and brackets."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from rfpipe.errors import ConfigError

API = 1
"""Version of the interface."""

_ADVICE = (
    "make one with: (umask 077; python -c 'import secrets; print(secrets.token_urlsafe(32))' "
    "> rig.token)"
)


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

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
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


def read_token(file: Path | None = None, variable: str = "RFPIPE_TOKEN") -> str:
    """Read the bearer token from a file or from the environment; never from a command line.

    The file holds nothing but the token, 16 to 512 visible ASCII characters, and nobody but its
    owner may read it.

    Raises
    ------
    ConfigError
        When there is none, others may read the file, or the token is too short, too long or holds
        other characters. No message shows it.
    """
    source, token = f"the environment variable {variable}", os.environ.get(variable, "")
    if file is not None:
        source = str(file)
        try:
            with file.open(encoding="utf-8") as opened:
                mode, token = stat.S_IMODE(os.fstat(opened.fileno()).st_mode), opened.read(1024)
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(
                f"{file}: can't be read as a token file: {error}; {_ADVICE}"
            ) from error
        if os.name == "posix" and mode & 0o077:
            raise ConfigError(
                f"{file}: has the mode {mode:o}, so that others may read the token; run: "
                f"chmod 600 {file}"
            )
        token = token.strip()
    elif not token:
        raise ConfigError(f"{source} is not set and no token file is named; {_ADVICE}")
    is_visible = token.isascii() and all(33 <= ord(character) <= 126 for character in token)
    if not is_visible or not 16 <= len(token) <= 512:
        raise ConfigError(
            f"{source}: holds a token of {len(token)} characters; expected 16 to 512 ASCII "
            f"letters, digits and signs without spaces; {_ADVICE}"
        )
    return token
