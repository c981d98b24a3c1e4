"""What stands before the application: the token, limits on bodies and answers, and the log."""

from __future__ import annotations

import asyncio
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
_PIECE_BYTES = 2**18
_HEADERS = ((b"cache-control", b"no-store"), (b"x-content-type-options", b"nosniff"))
_CLOSE = (b"connection", b"close")

_log = logging.getLogger("rfpipe.server.requests")


class _NotTakenError(Exception):
    """The client doesn't take its answer."""


class Guard:
    """ASGI middleware that lets no request through without the token, nor with too long a body.

    Nothing of a body is read before the token was found right, and connections of those who haven't
    shown it end with their answer: they can't keep others out. A body has to arrive, and each piece
    of an answer to be taken, in time.

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
        path, headers = scope["path"], dict(scope["headers"])
        is_known = self._is_right(headers.get(b"authorization"))
        seconds = self._settings.body_seconds
        send = _logged(_in_pieces(send, seconds), scope, closes=not is_known)
        most = self._settings.most_request_bytes if path == CAPTURE_PATH else _SMALL_BODY_BYTES
        declared = _declared_length(headers)
        if not is_known and path not in _OPEN_PATHS:
            refusal = problem_response(
                401,
                "the bearer token is missing or wrong; it is the one that the server was started "
                "with",
                {"WWW-Authenticate": "Bearer"},
            )
        elif declared > most:
            # closed, rather than to read a long body to its end
            refusal = problem_response(
                413,
                f"a body of {declared} bytes; up to {most} are allowed here",
                {"Connection": "close"},
            )
        else:
            try:
                await self._app(scope, _limited(receive, most, seconds), send)
            except _NotTakenError:
                _log.warning("%s: the answer was not taken in time", path)
            return
        await refusal(scope, receive, send)

    def _is_right(self, authorization: bytes | None) -> bool:
        scheme, _, given = (authorization or b"").partition(b" ")
        # of digests, so that the time tells nothing of the token's length, either
        same = hmac.compare_digest(hashlib.sha256(given.strip()).digest(), self._token)
        return scheme.lower() == b"bearer" and same


def _declared_length(headers: dict[bytes, bytes]) -> int:
    length = headers.get(b"content-length", b"0")
    return int(length) if length.isdigit() else 0


def _limited(receive: Receive, most: int, seconds: float) -> Receive:
    """Refuse a body of more bytes than are allowed, or that takes longer since it is asked for."""
    left, deadline, is_whole = most, 0.0, False

    async def receive_limited() -> Message:
        nonlocal left, deadline, is_whole
        if is_whole:
            return await receive()
        deadline = deadline or asyncio.get_running_loop().time() + seconds
        try:
            async with asyncio.timeout_at(deadline):
                message = await receive()
        except TimeoutError:
            raise HTTPException(
                408, "the request did not arrive in time", {"Connection": "close"}
            ) from None
        is_whole = not message.get("more_body", False)
        left -= len(message.get("body", b""))
        if left < 0:
            raise HTTPException(
                413, f"the body is longer than {most} bytes", {"Connection": "close"}
            )
        return message

    return receive_limited


def _in_pieces(send: Send, seconds: float) -> Send:
    """Send a body piece by piece, each when the one before it was taken.

    Raises _NotTakenError, and leaves the answer incomplete, where that takes too long.
    """

    async def send_pieces(message: Message) -> None:
        body = message.get("body", b"")
        starts = range(0, max(1, len(body)), _PIECE_BYTES)
        for start in starts:
            piece = message
            if len(starts) > 1:
                is_last = start == starts[-1] and not message.get("more_body", False)
                some = body[start : start + _PIECE_BYTES]
                piece = {**message, "body": some, "more_body": not is_last}
            try:
                async with asyncio.timeout(seconds):
                    await send(piece)
            except TimeoutError:
                raise _NotTakenError from None

    return send_pieces


def _logged(send: Send, scope: Scope, *, closes: bool) -> Send:
    """Log a response once it is sent; it `closes` its connection, or leaves it open."""
    status = sent = 0
    began = time.perf_counter()

    async def send_counted(message: Message) -> None:
        nonlocal status, sent
        if message["type"] == "http.response.start":
            status = message["status"]
            added = (*_HEADERS, _CLOSE) if closes else _HEADERS
            message["headers"] = [*message.get("headers", ()), *added]
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
