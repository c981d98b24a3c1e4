"""The sign of life by which a client keeps the rig."""

from __future__ import annotations

import logging
import threading

from rfpipe.rigs.connection import Connection

__all__ = ["HeartBeat"]

_BEATS_PER_LEASE = 4

_log = logging.getLogger(__name__)


class HeartBeat:
    """Renews a lease in the background until it is stopped, then gives it back.

    Parameters
    ----------
    connection : Connection
        Its own; is closed in the end.
    lease : str
    seconds : float
        How long the lease lasts without a heart-beat.
    """

    def __init__(self, connection: Connection, lease: str, seconds: float) -> None:
        self.lease = lease
        self._connection = connection
        self._interval = seconds / _BEATS_PER_LEASE
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heart-beat", daemon=True)
        self._thread.start()

    @property
    def has_stopped(self) -> bool:
        """Whether the server no longer knows the lease."""
        return not self._thread.is_alive()

    def stop(self) -> None:
        """Stop, and give the lease back if the server still knows it."""
        self._stop.set()
        self._thread.join()

    def _beat(self) -> None:
        import httpx

        headers = {"Rig-Lease": self.lease}
        try:
            while not self._stop.wait(self._interval):
                try:
                    answer = self._connection.try_once("PUT", "/v1/lease", headers=headers)
                except httpx.TransportError:
                    continue  # the capture itself says that the server is away
                if answer.status_code == 410:
                    return
            self._connection.try_once("DELETE", "/v1/lease", headers=headers)
        except httpx.TransportError as error:
            _log.info("the lease was not given back (%s); it lapses by itself", error)
        finally:
            self._connection.close()
