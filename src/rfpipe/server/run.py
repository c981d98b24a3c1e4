"""Start and stop of the acquisition server: socket, log and signals."""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from contextlib import closing, suppress
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI

from rfpipe.errors import ConfigError
from rfpipe.rigs import Rig
from rfpipe.server.api import create_app
from rfpipe.server.guard import guarded_protocol
from rfpipe.server.settings import ServerSettings
from rfpipe.server.worker import RigWorker

_log = logging.getLogger("rfpipe.server")


class _Server(uvicorn.Server):
    """uvicorn's server that, on a signal, stops after the current exposure."""

    def __init__(self, config: uvicorn.Config, worker: RigWorker) -> None:
        super().__init__(config)
        self.worker = worker

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.worker.stop()
        super().handle_exit(sig, frame)


def make_server(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> _Server:
    """Create the server of a rig; pass a `bound_socket` to its `run`."""
    app = create_app(rig, token, settings)
    config = local_config(
        app,
        http=guarded_protocol(settings),
        headers=[("cache-control", "no-store"), ("x-content-type-options", "nosniff")],
        timeout_keep_alive=120,
        # for running requests; the current exposure may take longer
        timeout_graceful_shutdown=30,
        h11_max_incomplete_event_size=16 * 2**10,
    )
    return _Server(config, app.state.served.worker)


def local_config(app: FastAPI, **options: Any) -> uvicorn.Config:
    """Uvicorn's settings of an application that trusts no proxy."""
    disabled: dict[str, Any] = {"log_config": None, "proxy_headers": False, "server_header": False}
    return uvicorn.Config(app, ws="none", **disabled, **options)


def bound_socket(host: str, port: int) -> socket.socket:
    """Open a listening socket, before the rig is opened.

    Raises
    ------
    ConfigError
        When the address is in use, or doesn't belong to this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        bound = socket.create_server((host, port), family=family, backlog=512)
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"server: can't listen on {host}, port {port}: {error}",
            remedy="Stop the program that uses the port, or choose another --port",
        ) from error
    # asyncio disables Nagle's delay of 40 ms per answer only if the protocol is given
    return socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP, bound.detach())


def serve(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> None:
    """Serve a rig until SIGTERM or SIGINT; then finish the current exposure and close the devices.

    Parameters
    ----------
    rig : Rig, or callable that returns one
        A callable is called in the thread that uses the rig.
    token : str
        The bearer token that clients must send.
    settings : ServerSettings

    Raises
    ------
    ConfigError
        When the socket can't be opened.
    RfpipeError
        When the rig can't be opened.
    """
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    with bound_socket(settings.host, settings.port) as bound:
        server = make_server(rig, token, settings)
        host, port = bound.getsockname()[:2]
        _log.info("serving the rig on http://%s:%d", f"[{host}]" if ":" in host else host, port)
        if not settings.is_loopback:
            _log.warning(
                "other machines can connect over plain HTTP, so that the token can be intercepted"
            )
        # uvicorn raises KeyboardInterrupt again after its end
        with closing(server.worker), suppress(KeyboardInterrupt):
            server.run(sockets=[bound])
