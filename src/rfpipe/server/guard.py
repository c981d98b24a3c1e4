"""Protection of the application: token, limits of connections and bodies, and error answers.

Errors are ``application/problem+json`` (RFC 9457), with a status, a description and a remedy.
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
"""Paths that need no token, since they reveal nothing about the rig."""

_SHORT_BODY = 4096  # largest body of requests without patterns, in bytes
_STATUSES = {InputError: 422, TransferError: 422, CaptureError: 502}


class Problem(BaseModel):
    """Description of an error."""

    title: str = Field(description="Name of the HTTP status.")
    status: int = Field(description="HTTP status.")
    detail: str = Field(description="Description of the error, and its remedy.")


def problem_response(
    status: int, detail: str, headers: Mapping[str, str] | None = None
) -> Response:
    """Create the response for an error."""
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    return Response(problem.model_dump_json(), status, headers, PROBLEM_TYPE)


def add_handlers(app: FastAPI) -> None:
    """Answer every error of an application by a `Problem`; the text of bugs isn't sent."""

    async def answered(_request: Request, error: Exception) -> Response:
        if isinstance(error, HTTPException):
            return problem_response(error.status_code, str(error.detail), error.headers)
        if isinstance(error, RequestValidationError):
            details = (
                f"{'.'.join(map(str, mistake['loc']))}: {mistake['msg']}"
                for mistake in error.errors()
            )
            return problem_response(422, "; ".join(details))
        if isinstance(error, ClientDisconnect):
            return problem_response(400, "the client closed the connection during its request")
        status = next((_STATUSES[kind] for kind in type(error).__mro__ if kind in _STATUSES), 500)
        text = "internal error of the server; see its log" if status == 500 else str(error)
        return problem_response(status, text)

    for kind in (*_STATUSES, HTTPException, RequestValidationError, ClientDisconnect, Exception):
        app.add_exception_handler(kind, answered)


class Guard:
    """ASGI middleware that refuses requests without the token or with too long a body.

    The token is checked before the body is read. A connection without the right token is closed
    after the answer, so that it doesn't block other clients.
    """

    def __init__(self, app: ASGIApp, token: str, settings: ServerSettings) -> None:
        self._app = app
        self._token = hashlib.sha256(token.encode()).digest()
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or pass it to the application; see the ASGI specification."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path, headers = scope["path"], dict(scope["headers"])
        has_token = self._has_token(headers.get(b"authorization", b""))
        limit = self._settings.most_request_bytes if path == CAPTURE_PATH else _SHORT_BODY
        length = headers.get(b"content-length", b"0")
        declared = int(length) if length.isdigit() else 0
        if not has_token:
            send = _closing(send)
        if not has_token and path not in _OPEN_PATHS:
            detail = "the bearer token is missing or wrong; send the token that the server was "
            refusal = problem_response(401, f"{detail}started with", {"WWW-Authenticate": "Bearer"})
            await refusal(scope, receive, send)
        elif b"transfer-encoding" in headers:
            detail = f"the body has no Content-Length; send it, with up to {limit} bytes"
            await problem_response(411, detail, {"Connection": "close"})(scope, receive, send)
        elif declared > limit:
            # the connection is closed instead of reading the body
            detail = f"the body has {declared} bytes; send up to {limit}"
            await problem_response(413, detail, {"Connection": "close"})(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _has_token(self, authorization: bytes) -> bool:
        scheme, _, given = authorization.partition(b" ")
        # digests have the same length, so that timing doesn't reveal the token's length
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
    """Create uvicorn's HTTP protocol with a deadline for headers and a limit of connections.

    uvicorn has no deadline for headers, and its limit refuses any further request, even from the
    holder of the rig. Here, the oldest connection without a request is closed instead. This is
    never a connection with the token, since other connections are closed after their answer.
    """

    class GuardedProtocol(H11Protocol):
        """Closes connections without a request after a deadline, or the oldest if too many."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.deadline = self.loop.call_later(settings.head_seconds, self.end)
            connections: set[Any] = self.connections
            if len(connections) > settings.most_connections:
                idle = (connection for connection in connections if connection.cycle is None)
                min(idle, key=lambda connection: connection.deadline.when()).end()

        def connection_lost(self, exc: Exception | None) -> None:
            self.deadline.cancel()
            super().connection_lost(exc)

        def end(self) -> None:
            """Close the connection if it has sent no request."""
            request: Any = self.cycle
            if not request:
                self.connections.discard(self)
                self.transport.close()

    return GuardedProtocol
