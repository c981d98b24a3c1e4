"""What a server allows, and where it listens."""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import ConfigError


@dataclass(frozen=True)
class ServerSettings:
    """Where a server listens, and its limits.

    Parameters
    ----------
    host : str
        Address to listen on; another than loopback needs `allow_remote`.
    port : int
        0 takes any free one.
    allow_remote : bool
        Whether other machines may connect. They talk plain HTTP: who listens in reads the token.
    lease_seconds : float
        How long a client that sends no heart-beat keeps the rig.
    log_file : Path or None
        Where to log beside stderr.
    most_patterns : int
        Patterns in a request.
    most_request_bytes : int
        Bytes of the body of a request, and of its patterns after decompression.
    most_response_bytes : int
        Bytes of the brackets that answer a request; one pattern is always allowed.
    most_connections : int
        Connections at a time; who has shown no token makes room for further ones.
    head_seconds, body_seconds : float
        Time in which a connection has to send its first head, and a request its body.
    kept_captures : int
        Answered requests whose brackets are kept for a client that asks again.

    Raises
    ------
    ConfigError
        When the address is not loopback without `allow_remote`.
    """

    host: str = "127.0.0.1"
    port: int = 8750
    allow_remote: bool = False
    lease_seconds: float = 15.0
    log_file: Path | None = None
    most_patterns: int = 64
    most_request_bytes: int = 64 * 2**20
    most_response_bytes: int = 128 * 2**20
    most_connections: int = 512
    head_seconds: float = 10.0
    body_seconds: float = 60.0
    kept_captures: int = 2

    def __post_init__(self) -> None:
        if not (self.allow_remote or self.is_loopback):
            raise ConfigError(
                f"server: {self.host} is no loopback address. Other machines could connect, over "
                "plain HTTP; an SSH tunnel to 127.0.0.1 is safer. To allow it all the same, pass "
                "--allow-remote"
            )

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        with suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"
