"""uvicorn's HTTP protocol with a deadline for heads and a bound on connections."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from rfpipe.server.problems import PROBLEM_TYPE, problem_body

if TYPE_CHECKING:
    from rfpipe.server.settings import ServerSettings

__all__ = ["guarded_protocol"]


def guarded_protocol(settings: ServerSettings) -> type[asyncio.Protocol]:
    """Return the protocol class of a server with these settings.

    uvicorn by itself waits for ever for the rest of a head, and its bound on connections refuses
    the next request of whoever asks, the holder of the rig included. Here, who has asked nothing
    yet makes room for new ones: that is never somebody who has shown the token, since the
    connections of those who haven't end with their answer (`rfpipe.server.guard`).
    """

    class GuardedProtocol(H11Protocol):
        """Closes connections whose requests don't arrive in time, and those that are too many."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            self.since = self.loop.time()
            self._deadline: asyncio.TimerHandle | None = None

        @property
        def is_idle(self) -> bool:
            """Whether no whole head is there that is still to be answered."""
            return self.cycle is None or self.cycle.response_complete

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._watch()
            if len(self.connections) > settings.most_connections:
                _longest_idle(self.connections).refuse(503, "too many connections; try again later")

        def connection_lost(self, exc: Exception | None) -> None:
            self._unwatch()
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._watch()

        def refuse(self, status: int, detail: str) -> None:
            """Close a connection that awaits no answer, and say why."""
            self._unwatch()
            if self.transport.is_closing():
                return
            reason, body = HTTPStatus(status).phrase.encode(), problem_body(status, detail)
            self.transport.write(
                b"HTTP/1.1 %d %s\r\nContent-Type: %s\r\nContent-Length: %d\r\n"
                b"Connection: close\r\n\r\n%s"
                % (status, reason, PROBLEM_TYPE.encode(), len(body), body)
            )
            self.connections.discard(self)
            self.transport.close()

        def _watch(self) -> None:
            """Wait for the head that has begun, or is to begin the connection; not anew each time.

            Between requests a connection may rest; for how long is uvicorn's to say.
            """
            if not self.is_idle or self.transport.is_closing():
                self._unwatch()
            elif self._deadline is None:
                self._deadline = self.loop.call_later(
                    settings.head_seconds, self.refuse, 408, "the request did not arrive in time"
                )

        def _unwatch(self) -> None:
            if self._deadline is not None:
                self._deadline.cancel()
                self._deadline = None

    def _longest_idle(connections: Iterable[Any]) -> GuardedProtocol:
        """Return who is to make room: who has asked nothing before all others, the oldest first."""
        idle = (one for one in connections if one.is_idle)
        found: GuardedProtocol = min(idle, key=lambda one: (one.cycle is not None, one.since))
        return found

    return GuardedProtocol
