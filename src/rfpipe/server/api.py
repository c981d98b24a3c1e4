"""The endpoints of the acquisition server, version 1."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import threading
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from contextlib import asynccontextmanager
from functools import cached_property
from math import prod
from typing import Annotated, Any

from fastapi import APIRouter, Depends, FastAPI, Header, HTTPException, Request, Response
from fastapi.security import HTTPBearer

import rfpipe
from rfpipe.errors import CaptureError, InputError, TransferError
from rfpipe.provenance import fingerprint
from rfpipe.rigs import Rig
from rfpipe.rigs.messages import MEDIA_TYPE, decode_patterns, pack
from rfpipe.rigs.protocol import (
    API,
    Health,
    LeaseAnswer,
    LeaseRequest,
    Limits,
    RigAnswer,
    StatusAnswer,
)
from rfpipe.server.guard import CAPTURE_PATH, PROBLEM_TYPE, Guard, Problem, add_handlers
from rfpipe.server.preview import preview_png
from rfpipe.server.settings import ServerSettings
from rfpipe.server.worker import (
    CaptureConflictError,
    CaptureStoppedError,
    LeaseHeldError,
    LeaseLapsedError,
    Leases,
    RigBusyError,
    RigWorker,
)

_log = logging.getLogger("rfpipe.server")

_STATUSES = {
    InputError: 422,
    TransferError: 422,
    CaptureConflictError: 422,
    LeaseHeldError: 409,
    LeaseLapsedError: 410,
    RigBusyError: 429,
    CaptureStoppedError: 503,
    CaptureError: 502,
}
"""How the endpoints answer where an error of these is raised; its text is the detail."""


def _problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the errors of an endpoint for the OpenAPI description."""
    content = {PROBLEM_TYPE: {"schema": Problem.model_json_schema()}}
    return {status: {"description": "See detail.", "content": content} for status in statuses}


_COMMON = _problems(400, 401, 405, 413)
_open = APIRouter(prefix="/v1", responses=_COMMON)
_closed = APIRouter(
    prefix="/v1", responses=_COMMON, dependencies=[Depends(HTTPBearer(auto_error=False))]
)


class _Served:
    """What the endpoints share."""

    def __init__(self, worker: RigWorker, leases: Leases, settings: ServerSettings) -> None:
        self.worker, self.leases = worker, leases
        self.began = time.monotonic()
        self.rig = _described(worker.rig, settings)
        self.drawn = 0, b""
        self.drawing = threading.Lock()
        self.reading = asyncio.Lock()
        """Held while a capture's body is in memory: one at a time."""

    @cached_property
    def arrays(self) -> bytes:
        """The message of the arrays of a resampled sensor."""
        arrays = getattr(self.worker.rig.sensor, "arrays", dict)
        return pack({}, arrays(), deflate=True)

    def lease(self, identity: str) -> LeaseAnswer:
        """Return the answer to who holds the rig."""
        return LeaseAnswer(lease=identity, seconds=self.leases.seconds)


def create_app(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> FastAPI:
    """Return the ASGI application that serves a rig.

    Parameters
    ----------
    rig : Rig, or callable that returns one
        A callable is called, once and now, in the thread that will use the rig.
    token : str
        The bearer token that clients must send.
    settings : ServerSettings

    Returns
    -------
    FastAPI
        Its shutdown closes the rig. `rfpipe.server.run` adds a deadline for heads.

    Raises
    ------
    RfpipeError
        When the rig can't be opened.
    """
    leases = Leases(settings.lease_seconds)
    worker = RigWorker(rig, leases, settings.kept_captures)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
        await asyncio.to_thread(worker.close)

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
    app.state.worker = worker
    app.state.served = _Served(worker, leases, settings)
    app.include_router(_open)
    app.include_router(_closed)
    app.add_middleware(Guard, token=token, settings=settings)
    add_handlers(app, _STATUSES)
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
        description="Random, the client's own; the same when the request is sent again.",
    ),
]


@_open.get("/health")
async def health(served: Served) -> Health:
    """Say that the server is there."""
    status = "stopping" if served.worker.is_stopping else "ok"
    return Health(status=status, version=rfpipe.__version__, api=API)


@_closed.get("/status")
async def status(served: Served) -> StatusAnswer:
    """Say who holds the rig and what happened since the start."""
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


@_closed.get("/rig/arrays", response_class=Response, responses={200: {"content": {MEDIA_TYPE: {}}}})
def rig_arrays(served: Served) -> Response:
    """Return the arrays of a resampled sensor; none of another one."""
    with served.drawing:
        return Response(served.arrays, media_type=MEDIA_TYPE)


@_closed.post("/lease", responses=_problems(409, 422))
async def acquire(request: LeaseRequest, served: Served) -> LeaseAnswer:
    """Take the rig for oneself."""
    identity = served.leases.acquire(request.client)
    _log.info("%s takes the rig", request.client)
    return served.lease(identity)


@_closed.put("/lease", responses=_problems(410, 422))
async def renew(lease: LeaseHeader, served: Served) -> LeaseAnswer:
    """Keep the rig: the heart-beat of its holder."""
    served.leases.renew(lease)
    return served.lease(lease)


@_closed.delete("/lease", status_code=204, responses=_problems(410, 422))
async def release(lease: LeaseHeader, served: Served) -> None:
    """Give the rig back."""
    _log.info("%s gives the rig back", served.leases.release(lease))
    served.worker.forget()


@_closed.post(
    CAPTURE_PATH.removeprefix("/v1"),
    response_class=Response,
    responses={
        200: {"content": {MEDIA_TYPE: {}}, "description": "The brackets, in the patterns' order."},
        **_problems(409, 410, 415, 422, 429, 502, 503),
    },
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def capture(request: Request, lease: LeaseHeader, key: KeyHeader, served: Served) -> Response:
    """Show patterns and return their brackets; the same request again isn't exposed again."""
    served.leases.renew(lease)
    if request.headers.get("content-type") != MEDIA_TYPE:
        raise HTTPException(415, f"the body must be of the type {MEDIA_TYPE}")
    served.worker.check_free(key)  # before anything of the body is read
    future = await _submitted(request, lease, key, served)
    # shielded: a client that goes away doesn't take the exposure back
    message = await asyncio.shield(asyncio.wrap_future(future))
    return Response(message, media_type=MEDIA_TYPE)


async def _submitted(request: Request, lease: str, key: str, served: _Served) -> Future[bytes]:
    """Read the body of a capture and have its patterns exposed; the body isn't kept."""
    limits = served.rig.limits

    def submit() -> Future[bytes]:
        digest = hashlib.sha256(body).hexdigest()
        future = served.worker.again(key, digest, lease)
        if future is not None:
            return future
        # all are checked before the first is shown
        patterns = decode_patterns(
            body, served.rig.projector_shape, limits.patterns, limits.request_bytes
        )
        return served.worker.submit(key, digest, lease, patterns)

    async with served.reading:
        body = b"".join([piece async for piece in request.stream()])
        return await asyncio.to_thread(submit)


@_closed.get(
    "/preview.png",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}, **_problems(404)},
)
def preview(served: Served) -> Response:
    """Draw the last bracket: exposures, saturation and histograms."""
    shown = served.worker.last
    if shown is None:
        raise HTTPException(404, "nothing was captured since the server's start")
    with served.drawing:
        if served.drawn[0] != shown.number:
            exposures = served.worker.rig.sensor.exposures
            served.drawn = shown.number, preview_png(shown, served.rig.sensor, exposures)
        return Response(served.drawn[1], media_type="image/png")


def _described(rig: Rig, settings: ServerSettings) -> RigAnswer:
    """Describe a rig, and how much of it a request may ask for."""
    description = rig.describe()
    bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
    brackets = settings.most_response_bytes // (bracket * rig.sensor.frame_dtype.itemsize)
    # of ones and zeros: eight a byte
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
        limits=Limits(
            patterns=max(1, min(settings.most_patterns, brackets, patterns)),
            request_bytes=settings.most_request_bytes,
            lease_seconds=settings.lease_seconds,
        ),
    )
