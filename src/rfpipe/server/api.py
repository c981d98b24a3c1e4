"""Endpoints of the acquisition server, API version 1."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from math import prod
from typing import Annotated, Any

from fastapi import APIRouter, Depends, FastAPI, Header, HTTPException, Request, Response
from fastapi.responses import StreamingResponse
from fastapi.security import HTTPBearer

import rfpipe
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.rigs.messages import (
    API,
    MEDIA_TYPE,
    Health,
    LeaseAnswer,
    LeaseRequest,
    RequestLimits,
    RigAnswer,
    StatusAnswer,
    decode_patterns,
    pack_message,
)
from rfpipe.server.guard import CAPTURE_PATH, PROBLEM_TYPE, Guard, Problem, add_handlers
from rfpipe.server.settings import ServerSettings
from rfpipe.server.worker import Leases, RigWorker

_log = logging.getLogger("rfpipe.server")

_MOST_PATTERNS = 64  # patterns in a request
_MOST_ANSWER_BYTES = 128 * 2**20  # size of an answer; one bracket is always allowed
_PIECE = 2**18  # bytes of a piece of an answer, sent after the previous one was received

_problem = {"content": {PROBLEM_TYPE: {"schema": Problem.model_json_schema()}}}
_errors: Any = {status: {"description": "See detail.", **_problem} for status in ("4XX", "5XX")}
_open = APIRouter(prefix="/v1", responses=_errors)
_closed = APIRouter(
    prefix="/v1", responses=_errors, dependencies=[Depends(HTTPBearer(auto_error=False))]
)


def _binary(media_type: str) -> Any:
    """Describe an endpoint whose answer is a file of one type."""
    return {"response_class": Response, "responses": {200: {"content": {media_type: {}}}}}


class _Served:
    """State shared by the endpoints."""

    def __init__(self, worker: RigWorker, settings: ServerSettings) -> None:
        self.worker, self.leases = worker, worker.leases
        self.began, self.body_seconds = time.monotonic(), settings.body_seconds
        self.rig = _described(worker.rig, settings)
        self.arrays = pack_message({}, worker.rig.sensor.arrays(), deflate=True)
        # only one request's body is in memory at a time
        self.reading = asyncio.Lock()


def create_app(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> FastAPI:
    """Create the ASGI application that serves a rig.

    Parameters
    ----------
    rig : Rig, or callable that returns one
        A callable is called immediately, in the thread that uses the rig.
    token : str
        The bearer token that clients must send.
    settings : ServerSettings

    Returns
    -------
    FastAPI
        Its shutdown closes the rig. `rfpipe.server.run` adds a deadline for request headers.

    Raises
    ------
    RfpipeError
        When the rig can't be opened.
    """
    worker = RigWorker(rig, Leases(settings.lease_seconds))

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
        await asyncio.to_thread(worker.close)  # before uvicorn re-raises SIGTERM

    app = FastAPI(
        title="rfpipe acquisition server",
        description="Shows patterns on a projector and returns the brackets of a camera.",
        version=rfpipe.__version__,
        openapi_url="/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        redirect_slashes=False,
    )
    app.state.served = _Served(worker, settings)
    app.include_router(_open)
    app.include_router(_closed)
    app.add_middleware(Guard, token=token, settings=settings)
    add_handlers(app)
    return app


async def _served(request: Request) -> _Served:
    served: _Served = request.app.state.served
    return served


Served = Annotated[_Served, Depends(_served)]
LeaseHeader = Annotated[
    str, Header(alias="Rig-Lease", min_length=8, max_length=128, description="The lease's id.")
]
KeyHeader = Annotated[
    str,
    Header(
        alias="Idempotency-Key",
        pattern="^[A-Za-z0-9_-]{16,64}$",
        description="Random identifier of the request, the same when the request is repeated.",
    ),
]


@_open.get("/health")
async def health(served: Served) -> Health:
    """Return state and version of the server."""
    status = "stopping" if served.worker.is_stopping else "ok"
    return Health(status=status, version=rfpipe.__version__, api=API)


@_closed.get("/status")
async def status(served: Served) -> StatusAnswer:
    """Return the holder of the rig, and counters since the start."""
    return StatusAnswer(
        up_seconds=time.monotonic() - served.began,
        holder=served.leases.holder,
        devices=getattr(served.worker.rig, "statistics", None) or {},
        **served.worker.metrics.model_dump(),
    )


@_closed.get("/rig")
async def rig(served: Served) -> RigAnswer:
    """Describe the rig."""
    return served.rig


@_closed.get("/rig/arrays", **_binary(MEDIA_TYPE))
async def rig_arrays(served: Served) -> Response:
    """Return the arrays of a resampled sensor; a message without arrays for another one."""
    return Response(served.arrays, media_type=MEDIA_TYPE)


@_closed.post("/lease")
async def acquire(request: LeaseRequest, served: Served) -> LeaseAnswer:
    """Acquire the rig."""
    identity = served.leases.acquire(request.client)
    _log.info("%s acquires the rig", request.client)
    return LeaseAnswer(lease=identity, seconds=served.leases.seconds)


@_closed.put("/lease")
async def renew(lease: LeaseHeader, served: Served) -> LeaseAnswer:
    """Renew the lease; the heartbeat of the rig's holder."""
    served.leases.renew(lease)
    return LeaseAnswer(lease=lease, seconds=served.leases.seconds)


@_closed.delete("/lease", status_code=204)
async def release(lease: LeaseHeader, served: Served) -> None:
    """Release the rig."""
    _log.info("%s releases the rig", served.leases.renew(lease, 0))
    served.worker.forget()


@_closed.post(
    CAPTURE_PATH.removeprefix("/v1"),
    **_binary(MEDIA_TYPE),
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def capture(request: Request, lease: LeaseHeader, key: KeyHeader, served: Served) -> Response:
    """Show patterns and return their brackets; a repeated request isn't exposed again."""
    served.leases.renew(lease)
    if request.headers.get("content-type") != MEDIA_TYPE:
        raise HTTPException(415, f"the body has another type; send {MEDIA_TYPE}")
    served.worker.check_free(key)  # before the body is read
    limits = served.rig.limits
    async with served.reading:
        try:
            async with asyncio.timeout(served.body_seconds):
                body = await request.body()
        except TimeoutError:
            detail = f"the body did not arrive within {served.body_seconds:g} s; send it again"
            raise HTTPException(408, detail, {"Connection": "close"}) from None
        digest = hashlib.sha256(body).hexdigest()
        patterns = partial(
            decode_patterns, body, served.rig.projector_shape, limits.patterns, limits.request_bytes
        )
        future = await asyncio.to_thread(served.worker.submit, key, digest, lease, patterns)
        del body, patterns
    # shielded: a client that disconnects doesn't cancel the exposure
    message = await asyncio.shield(asyncio.wrap_future(future))
    headers = {"Content-Length": str(len(message))}
    return StreamingResponse(_in_pieces(message), media_type=MEDIA_TYPE, headers=headers)


async def _in_pieces(message: bytes) -> AsyncIterator[bytes]:
    for first in range(0, len(message), _PIECE):
        yield message[first : first + _PIECE]


def _described(rig: Rig, settings: ServerSettings) -> RigAnswer:
    """Describe a rig and the limits of its requests."""
    description = rig.describe()
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    brackets = _MOST_ANSWER_BYTES // (bracket * rig.sensor.frame_dtype.itemsize)
    # binary patterns have eight rays per byte
    patterns = 8 * settings.most_request_bytes // prod(rig.projector_shape)
    return RigAnswer(
        camera_shape=rig.camera_shape,
        projector_shape=rig.projector_shape,
        channels=rig.channels,
        seconds_per_pattern=rig.seconds_per_pattern,
        sensor=rig.sensor.describe(),
        has_arrays=hasattr(rig.sensor, "arrays"),
        description=description,
        digest=fingerprint(description),
        limits=RequestLimits(
            patterns=max(1, min(_MOST_PATTERNS, brackets, patterns)),
            request_bytes=settings.most_request_bytes,
            lease_seconds=settings.lease_seconds,
        ),
    )
