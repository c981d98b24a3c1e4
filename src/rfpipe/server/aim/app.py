"""The page's application: the picture, what it tells, and what the projector shows."""

from __future__ import annotations

import hmac
from importlib.resources import files
from typing import Annotated, Any, Literal

from fastapi import Body, FastAPI, HTTPException, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from starlette.middleware.trustedhost import TrustedHostMiddleware

import rfpipe
from rfpipe.server.aim.watch import Watch

__all__ = ["create_app"]

_COOKIE = "rfpipe-aim"
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; frame-ancestors 'none'",
}


def create_app(watch: Watch, token: str) -> FastAPI:
    """Return the ASGI application of a page for one rig.

    Parameters
    ----------
    watch : Watch
    token : str
        Who opens ``/?token=...`` with it gets a cookie, and all else needs that.
    """
    app = FastAPI(
        title="rfpipe aim", version=rfpipe.__version__, openapi_url=None, docs_url=None,
        redoc_url=None,
    )  # fmt: skip
    # a page elsewhere that names this machine by a name of its own is no page of ours
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"])
    page = files("rfpipe.server.aim").joinpath("page.html").read_text(encoding="utf-8")

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
            told = "open the address that rfpipe aim printed: it has the token in it"
            answer = JSONResponse({"detail": told}, 401)
        for name, value in _HEADERS.items():
            answer.headers[name] = value
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

    @app.post("/mode", status_code=204)
    def mode(
        shown: Annotated[Literal["measure", "white", "stripes", "off"], Body(embed=True)],
    ) -> None:
        watch.turn(shown)

    return app
