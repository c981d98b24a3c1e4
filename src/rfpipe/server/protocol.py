"""uvicorn's HTTP protocol with deadlines for slow clients and a bound on connections."""

from __future__ import annotations

import asyncio
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from rfpipe.server.problems import PROBLEM_TYPE, problem_body

if TYPE_CHECKING:
    from rfpipe.server.settings import ServerSettings

__all__ = ["guarded_protocol"]


def guarded_protocol(settings: ServerSettings) -> type[asyncio.Protocol]:
    """Return the protocol class of a server with these settings.

    uvicorn by itself waits for ever for the rest of a head or a body and for a response to be
    taken, and its bound on connections refuses the next request of whoever asks, the holder of
    the rig included. Here a new connection is refused, and those that are there go on.
    """

    class GuardedProtocol(H11Protocol):
        """Closes connections whose requests don't arrive in time."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            self._deadline: asyncio.TimerHandle | None = None
            self._awaits_body = False
            self._stalled: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            if len(self.connections) > settings.most_connections:
                self._refuse(503, "too many connections; try again later")
                return
            self._watch()

        def connection_lost(self, exc: Exception | None) -> None:
            self._unwatch()
            self._end_stall()
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._watch_what_is_missing()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            self._watch_what_is_missing()

        def pause_writing(self) -> None:
            super().pause_writing()
            self._watch_progress(self.transport.get_write_buffer_size())

        def resume_writing(self) -> None:
            super().resume_writing()
            self._end_stall()

        def send_400_response(self, msg: str) -> None:
            self._refuse(400, f"{msg} It is malformed, or its head is too long.")

        def _watch_what_is_missing(self) -> None:
            state = self.conn.their_state
            if state is h11.SEND_BODY:
                if not self._awaits_body:
                    self._unwatch()
                    self._awaits_body = True
                    self._watch(settings.body_seconds)
            elif state is h11.IDLE and self.conn.trailing_data[0]:
                if self._awaits_body or self._deadline is None:
                    self._unwatch()
                    self._watch()
            else:
                self._unwatch()

        def _watch(self, seconds: float = settings.head_seconds) -> None:
            self._deadline = self.loop.call_later(seconds, self._too_late)

        def _unwatch(self) -> None:
            self._awaits_body = False
            if self._deadline is not None:
                self._deadline.cancel()
                self._deadline = None

        def _too_late(self) -> None:
            self._deadline = None
            self._refuse(408, "the request did not arrive in time")

        def _watch_progress(self, left: int) -> None:
            self._end_stall()
            self._stalled = self.loop.call_later(settings.body_seconds, self._check_progress, left)

        def _check_progress(self, before: int) -> None:
            left = self.transport.get_write_buffer_size()
            if left < before:
                self._watch_progress(left)
            else:
                self.transport.abort()

        def _end_stall(self) -> None:
            if self._stalled is not None:
                self._stalled.cancel()
                self._stalled = None

        def _refuse(self, status: int, detail: str) -> None:
            """Answer where no answer was begun, and close the connection."""
            self._unwatch()
            if self.transport.is_closing():
                return
            busy = self.cycle is not None and not self.cycle.response_complete
            if not (busy and self.cycle.response_started):
                reason, body = HTTPStatus(status).phrase.encode(), problem_body(status, detail)
                self.transport.write(
                    b"HTTP/1.1 %d %s\r\nContent-Type: %s\r\nContent-Length: %d\r\n"
                    b"Connection: close\r\n\r\n%s"
                    % (status, reason, PROBLEM_TYPE.encode(), len(body), body)
                )
            if busy:
                self.cycle.disconnected = True
                self.cycle.message_event.set()
            self.transport.close()

    return GuardedProtocol
