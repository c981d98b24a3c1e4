"""Address and limits of the acquisition server."""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from dataclasses import dataclass

from rfpipe.errors import ConfigError


@dataclass(frozen=True)
class ServerSettings:
    """Address and limits of a server.

    Parameters
    ----------
    host : str
        Address to listen on; an address other than loopback needs `allow_remote`.
    port : int
        0 selects a free one.
    allow_remote : bool
        Whether other machines may connect. They use plain HTTP, so that the token can be
        intercepted.
    lease_seconds : float
        Duration of a lease without a heartbeat.
    most_request_bytes : int
        Largest size of a request's body, and of its patterns after decompression.
    most_connections : int
        Largest number of connections; above it, connections without a request are closed.
    head_seconds, body_seconds : float
        Deadlines for the headers of a connection's first request, and for the body of a capture.

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
                f"server: {self.host} is not a loopback address, so that other machines could "
                "connect over plain HTTP",
                remedy="Use an SSH tunnel to 127.0.0.1, which is safer, or pass --allow-remote",
            )

    @property
    def is_loopback(self) -> bool:
        """True if only this machine can connect to the address."""
        with suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"
