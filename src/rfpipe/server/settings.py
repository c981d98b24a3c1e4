"""What a server allows, and where it listens."""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from dataclasses import dataclass

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
    most_request_bytes : int
        Bytes of the body of a request, and of its patterns after decompression.
    most_connections : int
        Connections at a time; who has shown no token makes room for further ones.
    head_seconds, body_seconds : float
        Time in which a connection has to send its first head, and a capture its body.

    Raises
    ------
    ConfigError
        When the address is not loopback without `allow_remote`.
    """

    host: str = "127.0.0.1"
    port: int = 8750
    allow_remote: bool = False
    lease_seconds: float = 15.0
    most_request_bytes: int = 64 * 2**20
    most_connections: int = 512
    head_seconds: float = 10.0
    body_seconds: float = 60.0

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
