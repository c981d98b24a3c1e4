"""Running the server: its socket, its log, its signals, and its end."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Callable
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType

import uvicorn

from rfpipe.errors import ConfigError
from rfpipe.rigs import Rig
from rfpipe.server.api import create_app
from rfpipe.server.guard import guarded_protocol
from rfpipe.server.settings import ServerSettings
from rfpipe.server.worker import RigWorker

_log = logging.getLogger("rfpipe.server")


class _Server(uvicorn.Server):
    """Lets the exposure in hand be the last one when a signal asks to stop."""

    def __init__(self, config: uvicorn.Config, worker: RigWorker) -> None:
        super().__init__(config)
        self.worker = worker

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.worker.stop()
        super().handle_exit(sig, frame)


class _JsonLines(logging.Formatter):
    """One JSON object a record."""

    def format(self, record: logging.LogRecord) -> str:
        extra = ((name, getattr(record, name, None)) for name in ("client", "ms", "bytes"))
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **{name: value for name, value in extra if value},
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line)


def start_log(file: Path | None = None) -> None:
    """Log lines of JSON to stderr, and to the end of a file where one is named.

    Raises
    ------
    ConfigError
        When the file can't be written.
    """
    handlers: list[logging.Handler] = [logging.StreamHandler()]
    if file is not None:
        try:
            handlers.append(logging.FileHandler(file, encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{file}: can't be written as a log file: {error}") from error
    for handler in handlers:
        handler.setFormatter(_JsonLines())
    for name in ("rfpipe", "uvicorn.error"):
        logger = logging.getLogger(name)
        logger.handlers = list(handlers)
        logger.setLevel(logging.INFO)
        logger.propagate = False


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
        timeout_keep_alive=120,
        # for requests under way; the exposure in hand has what time it takes
        timeout_graceful_shutdown=30,
        h11_max_incomplete_event_size=16 * 2**10,
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
        bound = socket.create_server(address, family=family, backlog=512, dualstack_ipv6=is_dual)
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
