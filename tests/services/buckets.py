"""A local S3 server, and a proxy that simulates failures of networks and servers."""

from __future__ import annotations

import http.client
import os
import socket
import subprocess
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler

import pytest
from tests.services.ports import free_port
from tests.services.web_servers import listening

BUCKET = "lab"
_HOP = {"connection", "keep-alive", "transfer-encoding", "content-length", "date", "server"}


@contextmanager
def s3_server(python: str) -> Iterator[str]:
    """Run an S3 server with one empty bucket, `BUCKET`; yields its endpoint."""
    port = free_port()
    endpoint = f"http://127.0.0.1:{port}"
    process = subprocess.Popen(
        [python, "-W", "ignore", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": ""},
    )
    try:
        put(f"{endpoint}/{BUCKET}", b"", patience=60.0)
        yield endpoint
    finally:
        process.terminate()
        process.wait(60)


def put(address: str, content: bytes, patience: float = 0.0) -> None:
    """Create a publicly readable object, or a bucket, with an unsigned request."""
    headers = {"Content-Type": "application/octet-stream", "x-amz-acl": "public-read"}
    request = urllib.request.Request(address, content, headers, method="PUT")
    end = time.monotonic() + patience
    while True:
        try:
            with urllib.request.urlopen(request, timeout=10):
                return
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)


def use(monkeypatch: pytest.MonkeyPatch, endpoint: str, *, signed: bool = True) -> None:
    """Set the environment variables of a client of the server."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint)
    monkeypatch.setenv("AWS_REGION", "us-east-1")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        if signed:
            monkeypatch.setenv(name, "testing")
        else:
            monkeypatch.delenv(name, raising=False)


@dataclass
class Faults:
    """Faults that a proxy injects into requests that write objects, and a log of all requests.

    Attributes
    ----------
    fail : int
        Number of next requests to answer with status 500.
    cut : int
        Number of next requests whose connection is closed in the middle of the content.
    deny : bool
        Whether to answer with status 403.
    limit : int or None
        Number of writes to pass on; further ones wait until this changes.
    under_way : set of int
        Identifiers of the threads that process a request.
    requests : list of (method, path, bytes sent, bytes received)
    """

    endpoint: str = ""
    fail: int = 0
    cut: int = 0
    deny: bool = False
    limit: int | None = None
    under_way: set[int] = field(default_factory=set)
    requests: list[tuple[str, str, int, int]] = field(default_factory=list)

    def written(self) -> list[str]:
        """Return the paths of the objects written, one per request passed on."""
        return [path for method, path, *_ in self.requests if method == "PUT"]


class _ProxyHandler(BaseHTTPRequestHandler):
    """Passes requests on to the server at `host`, with the faults of `faults`."""

    protocol_version = "HTTP/1.1"
    faults: Faults
    host: str

    def process(self) -> None:
        self.faults.under_way.add(threading.get_ident())
        try:
            length = int(self.headers.get("Content-Length", 0))
            is_write = self.command in ("PUT", "POST")
            if not (is_write and self.has_failed(length)):
                self.pass_on(length)
        finally:
            self.faults.under_way.remove(threading.get_ident())

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = process  # noqa: N815

    def has_failed(self, length: int) -> bool:
        """Simulate the fault of a write, if there is one."""
        faults = self.faults
        while faults.limit is not None and len(faults.written()) >= faults.limit:
            time.sleep(0.01)
        if faults.cut:
            faults.cut -= 1
            self.rfile.read(length // 2)
            self.connection.shutdown(socket.SHUT_RDWR)
            self.close_connection = True
            return True
        if faults.deny or faults.fail:
            self.rfile.read(length)
            faults.fail -= 0 if faults.deny else 1
            code = "AccessDenied" if faults.deny else "InternalError"
            text = f"<Error><Code>{code}</Code><Message>Not now</Message></Error>"
            self.answer(403 if faults.deny else 500, {}, text.encode())
            return True
        return False

    def pass_on(self, length: int) -> None:
        content = self.rfile.read(length)
        connection = http.client.HTTPConnection(self.host, timeout=30)
        connection.request(self.command, self.path, content, dict(self.headers))
        response = connection.getresponse()
        received = response.read()
        self.faults.requests.append((self.command, self.path, len(content), len(received)))
        self.answer(response.status, dict(response.getheaders()), received)
        connection.close()

    def answer(self, status: int, headers: dict[str, str], content: bytes) -> None:
        self.send_response(status)
        for name, value in headers.items():
            if name.lower() not in _HOP:
                self.send_header(name, value)
        self.send_header("Content-Length", headers.get("Content-Length", str(len(content))))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def proxy(server: str) -> Iterator[Faults]:
    """Pass requests on to an S3 server, with the faults that the yielded object states."""

    class Handler(_ProxyHandler):
        faults = Faults()
        host = server.removeprefix("http://")

    with listening(Handler) as Handler.faults.endpoint:
        yield Handler.faults
