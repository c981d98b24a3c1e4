"""What stands before the application: token, limits on connections and bodies, and errors.

Errors are ``application/problem+json`` (RFC 9457): a status, and what to do about it.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
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

from rfpipe.errors import CaptureError, InputError, TransferError

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from rfpipe.server.settings import ServerSettings

CAPTURE_PATH = "/v1/captures"
PROBLEM_TYPE = "application/problem+json"

_OPEN_PATHS = frozenset({"/v1/health", "/v1/openapi.json"})
"""Paths that need no token: they tell nothing of the rig."""

_SHORT_BODY = 4096  # bytes of requests that send no patterns
_STATUSES = {InputError: 422, TransferError: 422, CaptureError: 502}


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


def add_handlers(app: FastAPI) -> None:
    """Answer every error of an application by a problem; bugs without their text."""

    async def answered(_request: Request, error: Exception) -> Response:
        if isinstance(error, HTTPException):
            return problem_response(error.status_code, str(error.detail), error.headers)
        if isinstance(error, RequestValidationError):
            details = (f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
            return problem_response(422, "; ".join(details))
        if isinstance(error, ClientDisconnect):
            return problem_response(400, "the client closed the connection within its request")
        status = next((_STATUSES[kind] for kind in type(error).__mro__ if kind in _STATUSES), 500)
        text = "the server made a mistake; its log says more" if status == 500 else str(error)
        return problem_response(status, text)

    for kind in (*_STATUSES, HTTPException, RequestValidationError, ClientDisconnect, Exception):
        app.add_exception_handler(kind, answered)


class Guard:
    """ASGI middleware that lets no request through without the token, nor with too long a body.

    Nothing of a body is read before the token was found right, and connections of those who haven't
    shown it end with their answer: they can't keep others out.
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
        most = self._settings.most_request_bytes if path == CAPTURE_PATH else _SHORT_BODY
        length = headers.get(b"content-length", b"0")
        declared = int(length) if length.isdigit() else 0
        if not is_known:
            send = _closing(send)
        if not is_known and path not in _OPEN_PATHS:
            detail = "the bearer token is missing or wrong; it is the one that the server was "
            refusal = problem_response(401, f"{detail}started with", {"WWW-Authenticate": "Bearer"})
            await refusal(scope, receive, send)
        elif b"transfer-encoding" in headers:
            detail = f"a body without Content-Length; up to {most} bytes are allowed here"
            await problem_response(411, detail, {"Connection": "close"})(scope, receive, send)
        elif declared > most:
            # closed, rather than to read a long body to its end
            detail = f"a body of {declared} bytes; up to {most} are allowed here"
            await problem_response(413, detail, {"Connection": "close"})(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _is_right(self, authorization: bytes) -> bool:
        scheme, _, given = authorization.partition(b" ")
        # of digests, so that the time tells nothing of the token's length, either
        same = hmac.compare_digest(hashlib.sha256(given.strip()).digest(), self._token)
        return scheme.lower() == b"bearer" and same


def _closing(send: Send) -> Send:
    """Close the connection after the answer."""

    async def send_last(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), (b"connection", b"close")]
        await send(message)

    return send_last


def guarded_protocol(settings: ServerSettings) -> type[asyncio.Protocol]:
    """Return uvicorn's HTTP protocol with a deadline for first heads and a bound on connections.

    uvicorn by itself waits for ever for a head, and its bound refuses the next request of whoever
    asks, the holder of the rig included. Here, whoever has asked nothing yet makes room: never one
    who has shown the token, since other connections end with their answer.
    """

    class GuardedProtocol(H11Protocol):
        """Closes connections that ask nothing in time, and the longest where they are too many."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.deadline = self.loop.call_later(settings.head_seconds, self.end)
            connections: set[Any] = self.connections
            if len(connections) > settings.most_connections:
                waiting = (one for one in connections if one.cycle is None)
                min(waiting, key=lambda one: one.deadline.when()).end()

        def connection_lost(self, exc: Exception | None) -> None:
            self.deadline.cancel()
            super().connection_lost(exc)

        def end(self) -> None:
            """Close the connection if it has asked nothing."""
            has_asked: Any = self.cycle
            if not has_asked:
                self.connections.discard(self)
                self.transport.close()

    return GuardedProtocol
