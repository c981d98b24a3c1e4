"""Ports for servers that are to be found where they were, also when they come back."""

import os
import socket
from itertools import count
from pathlib import Path

_RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_LOWEST = 10_000
_offsets = count(os.getpid() * 997)


def free_port() -> int:
    """Return a port that nobody listens on now, and that the system gives to none unasked.

    One that it gave to us could be another test's connection before a server takes it, or while
    the server is away.
    """
    end = int(_RANGE.read_text().split()[0]) if _RANGE.exists() else 32_768
    while True:
        port = _LOWEST + next(_offsets) % (end - _LOWEST)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
