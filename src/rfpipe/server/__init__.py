"""The acquisition server: runs next to the devices, owns them, and serves one client at a time.

``rfpipe serve RIG.yaml`` runs it; `rfpipe.rigs.RemoteRig` is its client. FastAPI and uvicorn are
loaded when a server is made.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.server.settings import ServerSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from fastapi import FastAPI

    from rfpipe.rigs import Rig

__all__ = ["ServerSettings", "create_app", "serve"]


def create_app(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> FastAPI:
    """Return the ASGI application that serves a rig; see `rfpipe.server.api.create_app`."""
    from rfpipe.server.api import create_app as create

    return create(rig, token, settings)


def serve(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> None:
    """Serve a rig until a signal ends it; see `rfpipe.server.run.serve`."""
    from rfpipe.server.run import serve as run

    run(rig, token, settings)
