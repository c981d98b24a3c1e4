"""Running the page until Ctrl-C."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from contextlib import closing, suppress

import uvicorn

from rfpipe.rigs.devices import Camera, Projector
from rfpipe.server.aim.app import create_app
from rfpipe.server.aim.watch import Watch
from rfpipe.server.run import bound_socket
from rfpipe.server.settings import ServerSettings

__all__ = ["aim"]


def aim(
    devices: Callable[[], tuple[Projector, Camera]],
    period: int,
    port: int,
    say: Callable[[str], object],
) -> None:
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
        Is told the page's address, its token in it, once it can be opened.

    Raises
    ------
    ConfigError
        When the port is taken.
    RfpipeError
        When the devices can't be opened.
    """
    token = secrets.token_urlsafe(24)
    watch = Watch(devices, period)
    with bound_socket(ServerSettings(port=port)) as bound, closing(watch):
        watch.start()
        config = uvicorn.Config(
            create_app(watch, token), log_config=None, access_log=False, ws="none",
            server_header=False, proxy_headers=False, timeout_graceful_shutdown=2,
        )  # fmt: skip
        say(f"http://127.0.0.1:{bound.getsockname()[1]}/?token={token}")
        with suppress(KeyboardInterrupt):  # uvicorn raises it again after its end
            uvicorn.Server(config).run(sockets=[bound])
