"""What stands before the application: the token, limits on bodies, and the log of requests."""

from __future__ import annotations

import hashlib
import hmac
import logging
import time
from typing import TYPE_CHECKING

from starlette.exceptions import HTTPException

from rfpipe.server.problems import problem_response

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from rfpipe.server.settings import ServerSettings

__all__ = ["CAPTURE_PATH", "OPEN_PATHS", "Guard"]

OPEN_PATHS = frozenset({"/v1/health", "/v1/openapi.json"})
"""Paths that need no token: they tell nothing of the rig."""

CAPTURE_PATH = "/v1/captures"

_SMALL_BODY_BYTES = 4096
_HEADERS = ((b"cache-control", b"no-store"), (b"x-content-type-options", b"nosniff"))

_log = logging.getLogger("rfpipe.server.requests")


class Guard:
    """ASGI middleware that lets no request through without the token, nor with too long a body.

    Nothing of a body is read before the token was found right.

    Parameters
    ----------
    app : ASGI application
    token : str
    settings : ServerSettings
    """

    def __init__(self, app: ASGIApp, token: str, settings: ServerSettings) -> None:
        self._app = app
        self._token = hashlib.sha256(token.encode()).digest()
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or hand on, a request; see the ASGI specification."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        response = _Response(send, scope)
        headers = dict(scope["headers"])
        most = (
            self._settings.most_request_bytes
            if scope["path"] == CAPTURE_PATH
            else _SMALL_BODY_BYTES
        )
        if scope["path"] not in OPEN_PATHS and not self._is_right(headers.get(b"authorization")):
            refusal = problem_response(
                401,
                "the bearer token is missing or wrong; it is the one that the server was started "
                "with",
                {"WWW-Authenticate": "Bearer"},
            )
        elif _declared_length(headers) > most:
            refusal = problem_response(
                413, f"a body of {_declared_length(headers)} bytes; up to {most} are allowed here"
            )
        else:
            await self._app(scope, _Body(receive, most), response)
            return
        if _declared_length(headers) > _SMALL_BODY_BYTES or b"transfer-encoding" in headers:
            refusal.headers["Connection"] = "close"  # rather than to read a long body to its end
        await refusal(scope, receive, response)

    def _is_right(self, authorization: bytes | None) -> bool:
        scheme, _, given = (authorization or b"").partition(b" ")
        # of digests, so that the time tells nothing of the token's length, either
        same = hmac.compare_digest(hashlib.sha256(given.strip()).digest(), self._token)
        return scheme.lower() == b"bearer" and same


def _declared_length(headers: dict[bytes, bytes]) -> int:
    length = headers.get(b"content-length", b"0")
    return int(length) if length.isdigit() else 0


class _Body:
    """Counts the bytes of a body as they arrive."""

    def __init__(self, receive: Receive, most: int) -> None:
        self._receive = receive
        self._left = most
        self._most = most

    async def __call__(self) -> Message:
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        if self._left < 0:
            raise HTTPException(
                413, f"the body is longer than {self._most} bytes", {"Connection": "close"}
            )
        return message


class _Response:
    """Sends a response and logs it."""

    def __init__(self, send: Send, scope: Scope) -> None:
        self._send = send
        self._scope = scope
        self._status = 0
        self._bytes = 0
        self._began = time.perf_counter()

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._status = message["status"]
            message["headers"] = [*message.get("headers", ()), *_HEADERS]
        self._bytes += len(message.get("body", b""))
        await self._send(message)
        if message["type"] == "http.response.body" and not message.get("more_body", False):
            self._log()

    def _log(self) -> None:
        client = self._scope.get("client")
        _log.log(
            logging.INFO if self._status < 400 else logging.WARNING,
            "%s %s: %d",
            self._scope["method"],
            self._scope["path"][:200],
            self._status,
            extra={
                "client": f"{client[0]}:{client[1]}" if client else None,
                "ms": round(1e3 * (time.perf_counter() - self._began), 1),
                "bytes": self._bytes,
            },
        )
