"""The acquisition server: runs next to the devices, owns them, and serves one client at a time.

``rfpipe serve RIG.yaml`` runs it; `rfpipe.rigs.RemoteRig` is its client. FastAPI and uvicorn are
loaded when a server is made.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.server.settings import ServerSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from rfpipe.rigs import Rig

__all__ = ["ServerSettings", "serve"]


def serve(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> None:
    """Serve a rig until a signal ends it; see `rfpipe.server.run.serve`."""
    from rfpipe.server.run import serve as run

    run(rig, token, settings)
