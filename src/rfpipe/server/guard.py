"""What stands before the application: token, limits on connections, bodies and answers; errors.

Errors are ``application/problem+json`` (RFC 9457): a status, and what to do about it.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import logging
import time
from collections.abc import Mapping
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from rfpipe.server.settings import ServerSettings

CAPTURE_PATH = "/v1/captures"

_OPEN_PATHS = frozenset({"/v1/health", "/v1/openapi.json"})
"""Paths that need no token: they tell nothing of the rig."""

_HEADERS = ((b"cache-control", b"no-store"), (b"x-content-type-options", b"nosniff"))

_log = logging.getLogger("rfpipe.server.requests")

PROBLEM_TYPE = "application/problem+json"


class Problem(BaseModel):
    """What went wrong."""

    title: str = Field(description="The status in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What was wrong and what to do about it.")


def problem_response(
    status: int, detail: str, headers: Mapping[str, str] | None = None
) -> Response:
    """Return an error's response."""
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    return Response(problem.model_dump_json(), status, headers, PROBLEM_TYPE)


def add_handlers(app: FastAPI, statuses: Mapping[type[Exception], int]) -> None:
    """Answer every error of an application by a problem; of `statuses` the text is for the client.

    Bugs are answered without their text.
    """

    async def answered(_request: Request, error: Exception) -> Response:
        if isinstance(error, HTTPException):
            return problem_response(error.status_code, str(error.detail), error.headers)
        if isinstance(error, RequestValidationError):
            details = (f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
            return problem_response(422, "; ".join(details))
        if isinstance(error, ClientDisconnect):
            return problem_response(400, "the client closed the connection within its request")
        status = next((statuses[kind] for kind in type(error).__mro__ if kind in statuses), 500)
        if status == 500:
            return problem_response(500, "the server made a mistake; its log says more")
        come_again = {"Retry-After": "1"} if status in (409, 429, 503) else None
        return problem_response(status, str(error), come_again)

    for kind in (*statuses, HTTPException, RequestValidationError, ClientDisconnect, Exception):
        app.add_exception_handler(kind, answered)


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
        is_known = self._is_right(headers.get(b"authorization", b""))
        seconds = self._settings.body_seconds
        send = _logged(_in_pieces(send, seconds), scope, closes=not is_known)
        most = self._settings.most_request_bytes if path == CAPTURE_PATH else 4096
        length = headers.get(b"content-length", b"0")
        declared = int(length) if length.isdigit() else 0
        if not is_known and path not in _OPEN_PATHS:
            detail = "the bearer token is missing or wrong; it is the one that the server was "
            refusal = problem_response(401, f"{detail}started with", {"WWW-Authenticate": "Bearer"})
        elif declared > most:
            # closed, rather than to read a long body to its end
            detail = f"a body of {declared} bytes; up to {most} are allowed here"
            refusal = problem_response(413, detail, {"Connection": "close"})
        else:
            try:
                await self._app(scope, _limited(receive, most, seconds), send)
            except _NotTakenError:
                _log.warning("%s: the answer was not taken in time", path)
            return
        await refusal(scope, receive, send)

    def _is_right(self, authorization: bytes) -> bool:
        scheme, _, given = authorization.partition(b" ")
        # of digests, so that the time tells nothing of the token's length, either
        same = hmac.compare_digest(hashlib.sha256(given.strip()).digest(), self._token)
        return scheme.lower() == b"bearer" and same


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
            detail = "the request did not arrive in time"
            raise HTTPException(408, detail, {"Connection": "close"}) from None
        is_whole = not message.get("more_body", False)
        left -= len(message.get("body", b""))
        if left < 0:
            detail = f"the body is longer than {most} bytes"
            raise HTTPException(413, detail, {"Connection": "close"})
        return message

    return receive_limited


def _in_pieces(send: Send, seconds: float) -> Send:
    """Send a body in pieces of a quarter MiB, each when the one before it was taken.

    Raises _NotTakenError, and leaves the answer incomplete, where that takes too long.
    """

    async def send_pieces(message: Message) -> None:
        body = message.get("body", b"")
        starts = range(0, max(1, len(body)), 2**18)
        for start in starts:
            piece = message
            if len(starts) > 1:
                is_last = start == starts[-1] and not message.get("more_body", False)
                some = body[start : start + 2**18]
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
            added = (*_HEADERS, (b"connection", b"close")) if closes else _HEADERS
            message["headers"] = [*message.get("headers", ()), *added]
        sent += len(message.get("body", b""))
        await send(message)
        if message["type"] == "http.response.body" and not message.get("more_body", False):
            client = scope.get("client")
            level = logging.INFO if status < 400 else logging.WARNING
            facts = {
                "client": f"{client[0]}:{client[1]}" if client else None,
                "ms": round(1e3 * (time.perf_counter() - began), 1),
                "bytes": sent,
            }
            place = scope["method"], scope["path"][:200]
            _log.log(level, "%s %s: %d", *place, status, extra=facts)

    return send_counted


def guarded_protocol(settings: ServerSettings) -> type[asyncio.Protocol]:
    """Return uvicorn's HTTP protocol with a deadline for heads and a bound on connections.

    uvicorn by itself waits for ever for the rest of a head, and its bound on connections refuses
    the next request of whoever asks, the holder of the rig included. Here, who has asked nothing
    yet makes room for new ones: that is never somebody who has shown the token, since the
    connections of those who haven't end with their answer.
    """

    class GuardedProtocol(H11Protocol):
        """Closes connections whose requests don't arrive in time, and those that are too many."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            self.since = self.loop.time()
            self._deadline: asyncio.TimerHandle | None = None

        @property
        def is_idle(self) -> bool:
            """Whether no whole head is there that is still to be answered."""
            return self.cycle is None or self.cycle.response_complete

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._watch()
            if len(self.connections) > settings.most_connections:
                # who has asked nothing before all others, the oldest first
                connections: set[Any] = self.connections
                idle = (one for one in connections if one.is_idle)
                longest = min(idle, key=lambda one: (one.cycle is not None, one.since))
                longest.refuse(503, "too many connections; try again later")

        def connection_lost(self, exc: Exception | None) -> None:
            self._unwatch()
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._watch()

        def refuse(self, status: int, detail: str) -> None:
            """Close a connection that awaits no answer, and say why."""
            self._unwatch()
            if self.transport.is_closing():
                return
            problem = problem_response(status, detail, {"Connection": "close"})
            lines = [b"HTTP/1.1 %d %s" % (status, HTTPStatus(status).phrase.encode())]
            lines += [name + b": " + value for name, value in problem.raw_headers]
            self.transport.write(b"\r\n".join([*lines, b"", bytes(problem.body)]))
            self.connections.discard(self)
            self.transport.close()

        def _watch(self) -> None:
            """Wait for the head that has begun, or is to begin the connection; not anew each time.

            Between requests a connection may rest; for how long is uvicorn's to say.
            """
            if not self.is_idle or self.transport.is_closing():
                self._unwatch()
            elif self._deadline is None:
                self._deadline = self.loop.call_later(
                    settings.head_seconds, self.refuse, 408, "the request did not arrive in time"
                )

        def _unwatch(self) -> None:
            if self._deadline is not None:
                self._deadline.cancel()
                self._deadline = None

    return GuardedProtocol
