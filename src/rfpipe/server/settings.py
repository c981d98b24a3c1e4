"""What a server allows, and where it listens."""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from rfpipe.config.base import Settings, explained
from rfpipe.errors import ConfigError


class ServerSettings(Settings):
    """Where a server listens, and its limits.

    Parameters
    ----------
    host : str
        Address to listen on; another than loopback needs `allow_remote`.
    port : int
        0 to 65535; 0 takes any free one.
    allow_remote : bool
        Whether other machines may connect. They talk plain HTTP: who listens in reads the token.
    lease_seconds : float
        How long a client that sends no heart-beat keeps the rig, 0.5 to 3600.
    most_patterns : int
        Patterns in a request, 1 to 1024.
    most_request_bytes : int
        Bytes of the body of a request, and of its patterns after decompression, at least 4096.
    most_response_bytes : int
        Bytes of the brackets that answer a request; fewer patterns fit where brackets are large,
        but always one.
    most_connections : int
        Connections at a time, at least 8; who has shown no token makes room for further ones.
    head_seconds : float
        Time in which a connection has to send the head of its request, above 0.
    body_seconds : float
        Time in which a request has to arrive whole, and each piece of a response to be taken,
        above 0.
    kept_captures : int
        Answered requests whose brackets are kept for a client that asks again, at least 1.
    log_file : Path or None
        Where to log beside stderr.

    Raises
    ------
    ConfigError
        When a setting is out of range, or the address is not loopback without `allow_remote`.
    """

    host: str = Field("127.0.0.1", min_length=1)
    port: int = Field(8750, ge=0, le=65535)
    allow_remote: bool = False
    lease_seconds: float = Field(15.0, ge=0.5, le=3600)
    most_patterns: int = Field(64, ge=1, le=1024)
    most_request_bytes: int = Field(64 * 2**20, ge=4096)
    most_response_bytes: int = Field(128 * 2**20, gt=0)
    most_connections: int = Field(512, ge=8)
    head_seconds: float = Field(10.0, gt=0)
    body_seconds: float = Field(60.0, gt=0)
    kept_captures: int = Field(2, ge=1)
    log_file: Path | None = None

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            lines = [f"server: {line}" for line in explained(error)]
            raise ConfigError("\n".join(lines)) from None

    @model_validator(mode="after")
    def _is_for_this_machine_alone(self) -> Self:
        if not (self.allow_remote or self.is_loopback):
            raise ValueError(
                f"{self.host} is no loopback address. Other machines could connect, over plain "
                "HTTP; an SSH tunnel to 127.0.0.1 is safer. To allow it all the same, pass "
                "--allow-remote"
            )
        return self

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        with suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"
