"""Who holds the rig: one client at a time, as long as its heart beats."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable


class LeaseHeldError(Exception):
    """Another client holds the rig."""


class LeaseLapsedError(Exception):
    """A lease is unknown here: it lapsed, was released, or the server was started anew."""


class Leases:
    """The one lease that a rig has; any thread may ask.

    Parameters
    ----------
    seconds : float
        How long it lasts without a heart-beat.
    clock : callable
        Returns seconds; never runs backwards.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.seconds = seconds
        self._clock = clock
        self._identity, self._client, self._until = "", "", clock()
        self._lock = threading.Lock()

    @property
    def holder(self) -> str | None:
        """What the client that holds the rig calls itself, if there is one."""
        return self._client if self._clock() < self._until else None

    def acquire(self, client: str) -> str:
        """Take the rig and return the holder's secret; LeaseHeldError where another has it."""
        with self._lock:
            if self.holder is not None:
                raise LeaseHeldError(
                    f"the rig is held by {self._client!r}, and for "
                    f"{self._until - self._clock():.1f} s yet if its heart stops; wait until it is "
                    "released"
                )
            self._identity, self._client = secrets.token_urlsafe(24), client
            self._until = self._clock() + self.seconds
            return self._identity

    def renew(self, identity: str) -> None:
        """Take a heart-beat; raises LeaseLapsedError where it comes too late."""
        with self._lock:
            self._check(identity)
            self._until = self._clock() + self.seconds

    def release(self, identity: str) -> str:
        """Give the rig back and return the client; LeaseLapsedError where it isn't the holder."""
        with self._lock:
            self._check(identity)
            self._until = self._clock()
            return self._client

    def is_held_by(self, identity: str) -> bool:
        """Tell whether this lease is in force."""
        given, known = (one.encode("utf-8", "surrogatepass") for one in (identity, self._identity))
        return self.holder is not None and secrets.compare_digest(given, known)

    def _check(self, identity: str) -> None:
        if not self.is_held_by(identity):
            raise LeaseLapsedError(
                "this lease is not in force: it lapsed or the server was started anew; acquire "
                "again"
            )
