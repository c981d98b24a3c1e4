"""Web servers of a folder, with or without byte ranges, that log their requests."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote


@dataclass
class Served:
    """A served folder: its address, a log of requests, and faults to simulate."""

    address: str = ""
    requests: list[tuple[str, int]] = field(default_factory=list)
    """Path and number of bytes of each answer."""
    authorizations: list[str | None] = field(default_factory=list)
    """Authorization header of each request."""
    seconds: float = 0.0
    """Delay before each eighth of an answer."""
    stalls: int = 0
    """Number of answers that stop in the middle, with the connection open."""

    @property
    def nbytes(self) -> int:
        return sum(size for _, size in self.requests)


class _FolderHandler(BaseHTTPRequestHandler):
    """Serves the files of `folder`; logs requests and simulates the faults of `served`."""

    protocol_version = "HTTP/1.1"
    served: Served
    folder: Path
    has_ranges: bool

    def do_GET(self) -> None:
        path = self.folder / unquote(self.path).lstrip("/")
        if not path.is_file():
            self._answer(404, b"")
            return
        content = path.read_bytes()
        byte_range = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        if byte_range is None or not self.has_ranges:
            self._answer(200, content)
            return
        size, (begin, end) = len(content), byte_range.groups()
        first = int(begin) if begin else max(0, size - int(end))
        last = min(int(end), size - 1) if begin and end else size - 1
        self._answer(206, content[first : last + 1], f"bytes {first}-{last}/{size}")

    do_HEAD = do_GET  # noqa: N815

    def _answer(self, status: int, content: bytes, content_range: str = "") -> None:
        # logged first, since the client continues as soon as it has the last byte
        self.served.requests.append((self.path, len(content)))
        self.served.authorizations.append(self.headers["Authorization"])
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        if content_range:
            self.send_header("Content-Range", content_range)
        self.send_header("ETag", '"one"')
        self.end_headers()
        if self.command != "HEAD":
            self._send(content)

    def _send(self, content: bytes) -> None:
        eighth = len(content) // 8 + 1
        for start in range(0, len(content), eighth):
            time.sleep(self.served.seconds)
            # before writing: after the last piece the client may already run its next test
            if self.served.stalls and start > len(content) // 2:
                self.served.stalls -= 1
                time.sleep(4.0)
                return
            self.wfile.write(content[start : start + eighth])

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def serving(folder: Path, *, ranges: bool = True) -> Iterator[Served]:
    """Serve a folder like a static web server."""
    served_folder = folder

    class Handler(_FolderHandler):
        served = Served()
        folder = served_folder
        has_ranges = ranges

    with listening(Handler) as Handler.served.address:
        yield Handler.served


@contextmanager
def listening(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    """Answer requests in threads of this process; yields the server's address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
