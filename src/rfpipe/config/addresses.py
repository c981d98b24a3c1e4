"""Addresses of servers, in settings and in arguments: each check returns its address."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

THREADS = "threads"
"""Where work is done, if not by the workers of a scheduler at an address."""

_SCHEDULER = re.compile(r"(tcp|tls|ucx)://[^\s/@]+:\d+")
_BUCKET = re.compile(r"s3://[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[^?#@\s]+)?/?")
_LABEL = r"(?!-)[\w-]{1,63}(?<!-)"
_SERVER = re.compile(rf"https?://({_LABEL}(\.{_LABEL})*\.?|\[[\da-f:.]+\])(:\d+)?/?", re.I)


def check_bucket(address: str) -> str:
    """Raise ValueError where an address is no folder in a bucket."""
    if not _BUCKET.fullmatch(address):
        raise ValueError(
            "should be a bucket, or a folder in one, such as s3://lab/desk; credentials stand in "
            "the environment, not in an address"
        )
    return address


def check_port(address: str) -> str:
    """Raise ValueError where the port of an address is none."""
    try:
        port = urlsplit(address).port
    except ValueError:
        port = 0
    if port == 0:
        raise ValueError("should have a port from 1 to 65535")
    return address


def check_workers(where: str) -> str:
    """Raise ValueError where work can't be done."""
    if where == THREADS:
        return where
    if not _SCHEDULER.fullmatch(where):
        raise ValueError(
            f"should be {THREADS}, or the address of a dask scheduler, such as tls://host:8786"
        )
    return check_port(where)


def check_server(url: str) -> str:
    """Raise ValueError where a URL can't be that of an acquisition server."""
    if not _SERVER.fullmatch(url):
        raise ValueError(
            "should be the address of an acquisition server, http or https, without a path, user "
            "or password, such as http://127.0.0.1:8750"
        )
    return check_port(url)
