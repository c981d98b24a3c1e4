"""Addresses of servers, in settings and in arguments."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

__all__ = ["THREADS", "check_bucket", "check_port", "check_server", "check_workers"]

THREADS = "threads"
"""Where work is done, if not by the workers of a scheduler at an address."""

_SCHEDULER = re.compile(r"(tcp|tls|ucx)://\S+:\d+")

_HOST_NAME = re.compile(r"(?!-)[a-z0-9_-]{1,63}(?<!-)(\.(?!-)[a-z0-9_-]{1,63}(?<!-))*\.?", re.I)


_BUCKET = re.compile(r"s3://[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[^?#@\s]+)?/?")


def check_bucket(address: str) -> None:
    """Raise ValueError where an address is no folder in a bucket; says what it should be."""
    if not _BUCKET.fullmatch(address):
        raise ValueError(
            "should be a bucket, or a folder in one, such as s3://lab/desk; credentials stand in "
            "the environment, not in an address"
        )


def check_port(address: str) -> None:
    """Raise ValueError where the port of an address is none, or it names a user."""
    try:
        port = urlsplit(address).port
    except ValueError:
        port = 0
    if port == 0:
        raise ValueError("should have a port from 1 to 65535")
    if "@" in address:
        raise ValueError("should name no user and no password: nobody asks for them there")


def check_workers(where: str) -> None:
    """Raise ValueError where work can't be done, says where it can."""
    if where == THREADS:
        return
    if not _SCHEDULER.fullmatch(where):
        raise ValueError(
            f"should be {THREADS}, or the address of a dask scheduler, such as tls://host:8786"
        )
    check_port(where)


def check_server(url: str) -> None:
    """Raise ValueError where a URL can't be that of an acquisition server; says what it should be.

    A name that nobody knows now may be known later: only one that no machine can have is refused.
    """
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
        name = host if ":" in host else host.encode("idna").decode()
    except ValueError:  # brackets that don't close, names too long
        host = name = ""
    is_server = (
        host != ""
        and parts.scheme in ("http", "https")
        and (":" in host or _HOST_NAME.fullmatch(name) is not None)
        and not _is_number_of_no_host(host)
        and not (parts.path.strip("/") or parts.query or parts.fragment)
    )
    if not is_server:
        raise ValueError(
            "should be the address of an acquisition server, http or https, without a path, such "
            "as http://127.0.0.1:8750"
        )
    check_port(url)


def _is_number_of_no_host(host: str) -> bool:
    """Whether a host is written in numbers, but isn't four of 0 to 255."""
    numbers = host.rstrip(".").split(".")
    if ":" in host or not numbers[-1].isdigit():
        return False
    return len(numbers) != 4 or not all(n.isdigit() and int(n) < 256 for n in numbers)
