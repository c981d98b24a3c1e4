"""Running the server: its socket, its signals, and its end."""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from contextlib import closing, suppress
from types import FrameType

import uvicorn

from rfpipe.errors import ConfigError
from rfpipe.rigs import Rig
from rfpipe.server.api import create_app
from rfpipe.server.log import start_log
from rfpipe.server.protocol import guarded_protocol
from rfpipe.server.settings import ServerSettings
from rfpipe.server.worker import RigWorker

__all__ = ["bound_socket", "make_server", "serve"]

_MOST_HEAD_BYTES = 16 * 2**10
_KEEP_ALIVE_SECONDS = 120
_BACKLOG = 512
# for requests under way; the exposure in hand has what time it takes
_SHUTDOWN_SECONDS = 30

_log = logging.getLogger("rfpipe.server")


class _Server(uvicorn.Server):
    """Lets the exposure in hand be the last one when a signal asks to stop."""

    def __init__(self, config: uvicorn.Config, worker: RigWorker) -> None:
        super().__init__(config)
        self.worker = worker

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.worker.stop()
        super().handle_exit(sig, frame)


def make_server(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> _Server:
    """Return the server of a rig, whose `run` takes the `bound_socket`."""
    app = create_app(rig, token, settings)
    config = uvicorn.Config(
        app,
        http=guarded_protocol(settings),
        ws="none",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        backlog=_BACKLOG,
        timeout_keep_alive=_KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=_SHUTDOWN_SECONDS,
        h11_max_incomplete_event_size=_MOST_HEAD_BYTES,
    )
    return _Server(config, app.state.worker)


def bound_socket(settings: ServerSettings) -> socket.socket:
    """Bind the address, before the rig is opened.

    Raises
    ------
    ConfigError
        When it is taken or not this machine's.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            settings.host, settings.port, type=socket.SOCK_STREAM
        )[0]
        is_dual = family == socket.AF_INET6 and socket.has_dualstack_ipv6()
        # listens at once: else others on this port are refused only once the rig is open
        bound = socket.create_server(
            address, family=family, backlog=_BACKLOG, dualstack_ipv6=is_dual
        )
    except OSError as error:
        raise ConfigError(
            f"server: can't listen on {settings.host}, port {settings.port}: {error}. Stop what "
            "listens there, or choose another --port"
        ) from error
    # with its protocol named: else asyncio leaves Nagle's delay of 40 ms in each answer
    return socket.socket(family, kind, protocol, bound.detach())


def serve(rig: Rig | Callable[[], Rig], token: str, settings: ServerSettings) -> None:
    """Serve a rig until SIGTERM or SIGINT; then the exposure in hand ends and the devices close.

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
        When the address can't be listened on or the log not be written.
    RfpipeError
        When the rig can't be opened.
    """
    start_log(settings.log_file)
    with bound_socket(settings) as bound:
        server = make_server(rig, token, settings)
        host, port = bound.getsockname()[:2]
        _log.info("serving the rig on http://%s:%d", f"[{host}]" if ":" in host else host, port)
        if not settings.is_loopback:
            _log.warning(
                "other machines can connect, over plain HTTP: whoever listens in reads the token"
            )
        # uvicorn raises KeyboardInterrupt again after its end
        with closing(server.worker), suppress(KeyboardInterrupt):
            server.run(sockets=[bound])
