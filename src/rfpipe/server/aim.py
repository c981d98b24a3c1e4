"""The page of `rfpipe aim`: what the camera sees, live, to frame, focus and expose."""

from __future__ import annotations

import hmac
import io
import secrets
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
import uvicorn
from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from numpy.typing import NDArray
from starlette.middleware.trustedhost import TrustedHostMiddleware

from rfpipe.calibration.context import camera_model
from rfpipe.calibration.scene import measure_scene, scene_image, scene_patterns
from rfpipe.errors import RfpipeError
from rfpipe.rigs.devices import Camera, Projector, bracket_of
from rfpipe.server.run import bound_socket, local_config

Devices = Callable[[], tuple[Projector, Camera]]

AGAIN_SECONDS = 2.0
"""Wait after a device failed, before it is tried again."""

_COOKIE = "rfpipe-aim"
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; frame-ancestors 'none'",
}


def aim(devices: Devices, period: int, port: int, say: Callable[[str], object]) -> None:
    """Serve the page of a rig on this machine alone, until SIGTERM or SIGINT.

    Parameters
    ----------
    devices : callable
        Returns projector and camera.
    period : int
        Of the stripes in projector pixels.
    port : int
        0 takes a free one.
    say : callable
        Is given the page's address, its token in it, once it can be opened.

    Raises
    ------
    ConfigError
        When the port is taken.
    RfpipeError
        When the devices can't be opened.
    """
    token = secrets.token_urlsafe(24)
    with bound_socket("127.0.0.1", port) as bound, closing(Watch(devices, period)) as watch:
        app = create_app(watch, token)
        config = local_config(app, access_log=False, timeout_graceful_shutdown=2)
        say(f"http://127.0.0.1:{bound.getsockname()[1]}/?token={token}")
        with suppress(KeyboardInterrupt):  # uvicorn raises it again after its end
            uvicorn.Server(config).run(sockets=[bound])


def create_app(watch: Watch, token: str) -> FastAPI:
    """Return the ASGI application of a page for one rig.

    Who opens ``/?token=...`` with the token gets a cookie, and all else needs that.
    """
    app = FastAPI(title="rfpipe aim", openapi_url=None, docs_url=None, redoc_url=None)
    # a page elsewhere that names this machine by a name of its own is no page of ours
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"])
    page = files("rfpipe.server").joinpath("aim.html").read_text(encoding="utf-8")

    def is_right(given: str | None) -> bool:
        return hmac.compare_digest((given or "").encode(), token.encode())

    @app.middleware("http")
    async def guard(request: Request, call_next: Any) -> Response:
        if request.url.path == "/" and is_right(request.query_params.get("token")):
            answer: Response = RedirectResponse("/", 303)
            answer.set_cookie(_COOKIE, token, httponly=True, samesite="strict")
        elif is_right(request.cookies.get(_COOKIE)):
            answer = await call_next(request)
        else:
            detail = "open the address that rfpipe aim printed: it has the token in it"
            answer = JSONResponse({"detail": detail}, 401)
        answer.headers.update(_HEADERS)
        return answer

    @app.get("/")
    def index() -> HTMLResponse:
        return HTMLResponse(page)

    @app.get("/state.json")
    def state() -> dict[str, Any]:
        return watch.state

    @app.get("/picture.png")
    def picture() -> Response:
        if not watch.look.picture:
            raise HTTPException(404, "nothing was seen yet")
        return Response(watch.look.picture, media_type="image/png")

    return app


class Look(NamedTuple):
    """The last look: its number from 1, a PNG file, and verdict, numbers and proposed bracket."""

    number: int
    picture: bytes
    facts: dict[str, Any]


class Watch:
    """Shows and looks until it is closed; a device that fails is reported, and tried again.

    Parameters
    ----------
    devices : callable
        Returns projector and camera; is called in the thread that uses them.
    period : int
        Of the stripes in projector pixels.

    Raises
    ------
    RfpipeError
        When a device can't be opened.
    """

    def __init__(self, devices: Devices, period: int) -> None:
        self._period = period
        self.look = Look(0, b"", {})
        self._error: str | None = None
        self._stopping = threading.Event()
        self._thread = ThreadPoolExecutor(1, "aim")
        try:
            projector, camera = self._thread.submit(devices).result()
        except BaseException:
            self._thread.shutdown()
            raise
        self._thread.submit(self._run, projector, camera)

    @property
    def state(self) -> dict[str, Any]:
        """Plain data: the last look, and the devices' error."""
        look = self.look
        return {"number": look.number, "error": self._error, **look.facts}

    def close(self) -> None:
        """Give the devices back, after the exposure in hand."""
        self._stopping.set()
        self._thread.shutdown()

    def _run(self, projector: Projector, camera: Camera) -> None:
        with closing(projector), closing(camera):
            while not self._stopping.is_set():
                try:
                    self._look_once(projector, camera)
                    self._error = None
                except RfpipeError as error:
                    self._error = str(error)
                    self._stopping.wait(AGAIN_SECONDS)

    def _look_once(self, projector: Projector, camera: Camera) -> None:
        """Take the pictures of a look; leave it where the page is closed meanwhile."""
        taken = []
        for index, shown in enumerate(scene_patterns(projector.shape, self._period)):
            taken.append(bracket_of(projector, camera, shown, f"picture {index}"))
            if self._stopping.is_set():
                return
        model = camera_model(camera)
        sight = measure_scene(taken, model.exposures, model.white_level, self._period)
        lit, dark = sight["lit"], sight["dark"]
        picture = scene_image(sight["white"], sight["saturated"], dark, lit)
        proposal = ", ".join(f"{one:g}" for one in sight["proposed_exposures_s"])
        facts = {
            "standing": sight.verdict.standing,
            "verdict": sight.verdict.text,
            "saturated": sight["saturated_share"],
            "dark": float(dark.sum() / max(lit.sum(), 1)),
            "lit": sight["lit_share"],
            "focus": sight["focus_contrast"],
            "exposures": list(model.exposures),
            "proposal": f"sensor:\n  exposures: [{proposal}]",
        }
        self.look = Look(self.look.number + 1, _png(picture), facts)


def _png(picture: NDArray[np.float64]) -> bytes:
    from matplotlib.image import imsave

    buffer = io.BytesIO()
    imsave(buffer, picture, format="png", metadata={"Software": ""})
    return buffer.getvalue()
