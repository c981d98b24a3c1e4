"""Checks of server addresses, in settings and in arguments; each returns the address unchanged."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

from rfpipe.errors import UnsuitableValueError

THREADS = "threads"
"""Value of ``resources.workers`` for threads of this machine instead of a dask scheduler."""

_SCHEDULER = re.compile(r"(tcp|tls|ucx)://[^\s/@]+:\d+")
_BUCKET = re.compile(r"s3://[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[^?#@\s]+)?/?")
_LABEL = r"(?!-)[\w-]{1,63}(?<!-)"
_SERVER = re.compile(rf"https?://({_LABEL}(\.{_LABEL})*\.?|\[[\da-f:.]+\])(:\d+)?/?", re.I)


def check_bucket(address: str) -> str:
    """Check the address of a bucket or of a folder in one.

    Raises
    ------
    UnsuitableValueError
        When the address has another form.
    """
    if not _BUCKET.fullmatch(address):
        raise UnsuitableValueError(
            "be a bucket, or a folder in one, such as s3://lab/desk; credentials belong in "
            "environment variables, not in an address"
        )
    return address


def check_port(address: str) -> str:
    """Check the port of an address; raises as `check_bucket`."""
    try:
        port = urlsplit(address).port
    except ValueError:
        port = 0
    if port == 0:
        raise UnsuitableValueError("have a port from 1 to 65535")
    return address


def check_workers(address: str) -> str:
    """Check the address of a dask scheduler, or ``threads``; raises as `check_bucket`."""
    if address == THREADS:
        return address
    if not _SCHEDULER.fullmatch(address):
        raise UnsuitableValueError(
            f"be {THREADS}, or the address of a dask scheduler, such as tls://host:8786"
        )
    return check_port(address)


def check_server(url: str) -> str:
    """Check the URL of an acquisition server; raises as `check_bucket`."""
    if not _SERVER.fullmatch(url):
        raise UnsuitableValueError(
            "be the address of an acquisition server, http or https, without a path, user or "
            "password, such as http://127.0.0.1:8750"
        )
    return check_port(url)
