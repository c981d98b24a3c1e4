"""Page of `rfpipe aim`: a live view of the camera's picture, to frame, focus and expose."""

from __future__ import annotations

import hmac
import io
import secrets
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from importlib.resources import files
from typing import Any, NamedTuple, Self

import numpy as np
import uvicorn
from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from numpy.typing import NDArray
from starlette.middleware.trustedhost import TrustedHostMiddleware

from rfpipe.calibration.context import StepContext, camera_model
from rfpipe.calibration.scene import measure_scene, scene_image, scene_patterns
from rfpipe.calibration.synchronisation import measure_synchronisation
from rfpipe.config import CalibrationConfig
from rfpipe.errors import RfpipeError
from rfpipe.rigs.devices import Camera, Projector, bracket_of
from rfpipe.server.run import bound_socket, local_config

Devices = Callable[[], tuple[Projector, Camera]]

RETRY_SECONDS = 2.0
"""Wait after a device failed."""

LOOKS_PER_TIMING = 10
"""Views of the scene per measurement of delay, frames and flicker."""

_COOKIE = "rfpipe-aim"
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; frame-ancestors 'none'",
}


def aim(devices: Devices, period: int, port: int, say: Callable[[str], object]) -> None:
    """Serve the page of a rig, for this machine only, until SIGTERM or SIGINT.

    Parameters
    ----------
    devices : callable
        Returns projector and camera.
    period : int
        Period of the stripes in projector pixels.
    port : int
        0 selects a free one.
    say : callable
        Called with the page's address, which contains its token, once it can be opened.

    Raises
    ------
    ConfigError
        When the port is in use.
    RfpipeError
        When the devices can't be opened.
    """
    token = secrets.token_urlsafe(24)
    with bound_socket("127.0.0.1", port) as bound, closing(SceneMonitor(devices, period)) as watch:
        app = create_app(watch, token)
        config = local_config(app, access_log=False, timeout_graceful_shutdown=2)
        say(f"http://127.0.0.1:{bound.getsockname()[1]}/?token={token}")
        with suppress(KeyboardInterrupt):  # raised by uvicorn after its end
            uvicorn.Server(config).run(sockets=[bound])


def create_app(watch: SceneMonitor, token: str) -> FastAPI:
    """Create the ASGI application of the page for one rig.

    The address ``/?token=...`` with the right token sets a cookie, which all other requests need.
    """
    app = FastAPI(title="rfpipe aim", openapi_url=None, docs_url=None, redoc_url=None)
    # against DNS rebinding: a foreign host name that resolves to this machine is refused
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"])
    page = files("rfpipe.server").joinpath("aim.html").read_text(encoding="utf-8")

    def is_valid(candidate: str | None) -> bool:
        return hmac.compare_digest((candidate or "").encode(), token.encode())

    @app.middleware("http")
    async def guard(request: Request, call_next: Any) -> Response:
        if request.url.path == "/" and is_valid(request.query_params.get("token")):
            answer: Response = RedirectResponse("/", 303)
            answer.set_cookie(_COOKIE, token, httponly=True, samesite="strict")
        elif is_valid(request.cookies.get(_COOKIE)):
            answer = await call_next(request)
        else:
            detail = "the token is missing or wrong; open the address that rfpipe aim printed"
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
        if not watch.view.picture:
            raise HTTPException(404, "the camera has taken no picture yet; try again")
        return Response(watch.view.picture, media_type="image/png")

    return app


class AimView(NamedTuple):
    """Latest view of the scene.

    Attributes
    ----------
    number : int
        Number of the view, from 1; 0 before the first one.
    picture : bytes
        PNG file.
    facts : dict
        Verdict, numbers and proposed exposures.
    """

    number: int
    picture: bytes
    facts: dict[str, Any]


class SceneMonitor:
    """Measures the scene repeatedly until it is closed; failed devices are reported and retried.

    Parameters
    ----------
    devices : callable
        Returns projector and camera; called in the thread that uses them.
    period : int
        Period of the stripes in projector pixels.

    Raises
    ------
    RfpipeError
        When a device can't be opened.
    """

    def __init__(self, devices: Devices, period: int) -> None:
        self._period = period
        self.view = AimView(0, b"", {})
        self._error: str | None = None
        self._timing: list[dict[str, str]] = []
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
        """Plain data: the latest view, verdicts on delay, frames and light, the devices' error."""
        view = self.view
        return {
            "number": view.number, "error": self._error, "timing": self._timing, **view.facts
        }  # fmt: skip

    def close(self) -> None:
        """Finish the current exposure, and close the devices."""
        self._stopping.set()
        self._thread.shutdown()

    def _run(self, projector: Projector, camera: Camera) -> None:
        with closing(projector), closing(camera), suppress(_PageClosedError):
            while not self._stopping.is_set():
                try:
                    self._measure(projector, camera)
                    self._error = None
                    self._measure_timing(projector, camera)
                except RfpipeError as error:
                    self._error = str(error)
                    self._stopping.wait(RETRY_SECONDS)

    def _measure(self, projector: Projector, camera: Camera) -> None:
        """Take the pictures of a view, and replace the latest one; stop if the page is closed."""
        brackets = []
        for index, pattern in enumerate(scene_patterns(projector.shape, self._period)):
            brackets.append(bracket_of(projector, camera, pattern, f"picture {index}"))
            if self._stopping.is_set():
                return
        model = camera_model(camera)
        scene = measure_scene(brackets, model.exposures, model.white_level, self._period)
        lit, dark = scene["lit"], scene["dark"]
        picture = scene_image(scene["white"], scene["saturated"], dark, lit)
        proposal = ", ".join(f"{seconds:g}" for seconds in scene["proposed_exposures_s"])
        facts = {
            "standing": scene.verdict.standing,
            "verdict": scene.verdict.text,
            "saturated": scene["saturated_share"],
            "dark": float(dark.sum() / max(lit.sum(), 1)),
            "lit": scene["lit_share"],
            "focus": scene["focus_contrast"],
            "exposures": list(model.exposures),
            "proposal": f"sensor:\n  exposures: [{proposal}]",
        }
        self.view = AimView(self.view.number + 1, _png(picture), facts)

    def _measure_timing(self, projector: Projector, camera: Camera) -> None:
        """Measure delay, frames and light after some views, and replace the latest verdicts."""
        if self.view.number % LOOKS_PER_TIMING != 1:
            return
        settings = CalibrationConfig(period_pixels=self._period)
        context = StepContext(projector, camera, settings, None, {}, self._progress)
        verdicts = measure_synchronisation(context)
        self._timing = [{"name": name, **verdict._asdict()} for name, verdict in verdicts.items()]

    @contextmanager
    def _progress(self, count: int) -> Iterator[Self]:
        """Progress bar of a measurement, which ends it when the page is closed."""
        del count
        yield self

    def advance(self, pictures: int) -> None:
        """Continue a measurement after a picture, or raise an error when the page is closed."""
        del pictures
        if self._stopping.is_set():
            raise _PageClosedError


class _PageClosedError(Exception):
    """The page is closed during a measurement."""


def _png(picture: NDArray[np.float64]) -> bytes:
    from matplotlib.image import imsave

    buffer = io.BytesIO()
    imsave(buffer, picture, format="png", metadata={"Software": ""})
    return buffer.getvalue()
