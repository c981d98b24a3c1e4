"""Free ports for servers that are stopped and started again at the same address."""

import os
import socket
from itertools import count
from pathlib import Path

_RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_LOWEST = 10_000
_offsets = count(os.getpid() * 997)


def free_port() -> int:
    """Return a free port outside the range that the system assigns by itself.

    A port from that range could be assigned to a connection of another test before the server
    binds it, or while the server is stopped.
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
