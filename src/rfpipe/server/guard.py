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

__all__ = ["CAPTURE_PATH", "Guard"]

_OPEN_PATHS = frozenset({"/v1/health", "/v1/openapi.json"})
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
        send, path, headers = _logged(send, scope), scope["path"], dict(scope["headers"])
        most = self._settings.most_request_bytes if path == CAPTURE_PATH else _SMALL_BODY_BYTES
        declared = _declared_length(headers)
        if path not in _OPEN_PATHS and not self._is_right(headers.get(b"authorization")):
            refusal = problem_response(
                401,
                "the bearer token is missing or wrong; it is the one that the server was started "
                "with",
                {"WWW-Authenticate": "Bearer"},
            )
        elif declared > most:
            refusal = problem_response(
                413, f"a body of {declared} bytes; up to {most} are allowed here"
            )
        else:
            await self._app(scope, _limited(receive, most), send)
            return
        if declared > _SMALL_BODY_BYTES or b"transfer-encoding" in headers:
            refusal.headers["Connection"] = "close"  # rather than to read a long body to its end
        await refusal(scope, receive, send)

    def _is_right(self, authorization: bytes | None) -> bool:
        scheme, _, given = (authorization or b"").partition(b" ")
        # of digests, so that the time tells nothing of the token's length, either
        same = hmac.compare_digest(hashlib.sha256(given.strip()).digest(), self._token)
        return scheme.lower() == b"bearer" and same


def _declared_length(headers: dict[bytes, bytes]) -> int:
    length = headers.get(b"content-length", b"0")
    return int(length) if length.isdigit() else 0


def _limited(receive: Receive, most: int) -> Receive:
    """Count the bytes of a body as they arrive, and refuse more than are allowed."""
    left = most

    async def receive_counted() -> Message:
        nonlocal left
        message = await receive()
        left -= len(message.get("body", b""))
        if left < 0:
            raise HTTPException(
                413, f"the body is longer than {most} bytes", {"Connection": "close"}
            )
        return message

    return receive_counted


def _logged(send: Send, scope: Scope) -> Send:
    """Log a response once it is sent."""
    status = sent = 0
    began = time.perf_counter()

    async def send_counted(message: Message) -> None:
        nonlocal status, sent
        if message["type"] == "http.response.start":
            status = message["status"]
            message["headers"] = [*message.get("headers", ()), *_HEADERS]
        sent += len(message.get("body", b""))
        await send(message)
        if message["type"] == "http.response.body" and not message.get("more_body", False):
            client = scope.get("client")
            _log.log(
                logging.INFO if status < 400 else logging.WARNING,
                "%s %s: %d",
                scope["method"],
                scope["path"][:200],
                status,
                extra={
                    "client": f"{client[0]}:{client[1]}" if client else None,
                    "ms": round(1e3 * (time.perf_counter() - began), 1),
                    "bytes": sent,
                },
            )

    return send_counted
