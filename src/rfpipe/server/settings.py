"""What a server allows, and where it listens."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import ConfigError

__all__ = ["ServerSettings"]


@dataclass(frozen=True)
class ServerSettings:
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
        Bytes of the body of a request, at least 4096.
    most_response_bytes : int
        Bytes of the brackets that answer a request; fewer patterns fit where brackets are large,
        but always one.
    most_connections : int
        Connections at a time, at least 8.
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

    host: str = "127.0.0.1"
    port: int = 8750
    allow_remote: bool = False
    lease_seconds: float = 15.0
    most_patterns: int = 64
    most_request_bytes: int = 64 * 2**20
    most_response_bytes: int = 256 * 2**20
    most_connections: int = 512
    head_seconds: float = 10.0
    body_seconds: float = 60.0
    kept_captures: int = 2
    log_file: Path | None = None

    def __post_init__(self) -> None:
        checks = {
            "port": (0 <= self.port <= 65535, "be 0 to 65535"),
            "lease_seconds": (0.5 <= self.lease_seconds <= 3600, "be 0.5 to 3600"),
            "most_patterns": (1 <= self.most_patterns <= 1024, "be 1 to 1024"),
            "most_request_bytes": (self.most_request_bytes >= 4096, "be at least 4096"),
            "most_response_bytes": (self.most_response_bytes > 0, "be above 0"),
            "most_connections": (self.most_connections >= 8, "be at least 8"),
            "head_seconds": (self.head_seconds > 0, "be above 0"),
            "body_seconds": (self.body_seconds > 0, "be above 0"),
            "kept_captures": (self.kept_captures >= 1, "be at least 1"),
        }
        for name, (is_right, expected) in checks.items():
            if not is_right:
                raise ConfigError(f"server: {name} is {getattr(self, name)}; it must {expected}")
        if not (self.allow_remote or self.is_loopback):
            raise ConfigError(
                f"server: {self.host} is no loopback address. Other machines could connect, over "
                "plain HTTP; an SSH tunnel to 127.0.0.1 is safer. To allow it all the same, pass "
                "--allow-remote"
            )

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False
