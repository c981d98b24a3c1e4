"""Who holds the rig: one client at a time, as long as its heart beats."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

__all__ = ["Lease", "LeaseHeldError", "LeaseLapsedError", "Leases"]


@dataclass(frozen=True)
class Lease:
    """The right to use the rig.

    Attributes
    ----------
    id : str
        The holder's secret.
    client : str
        What the holder calls itself.
    until : float
        When it lapses, by the clock of `Leases`.
    """

    id: str
    client: str
    until: float


class LeaseHeldError(Exception):
    """Another client holds the rig."""

    def __init__(self, lease: Lease, seconds_left: float) -> None:
        super().__init__(
            f"the rig is held by {lease.client!r}, and for {seconds_left:.1f} s yet if its heart "
            "stops; wait until it is released"
        )
        self.seconds_left = seconds_left


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
        self._lease: Lease | None = None
        self._lock = threading.Lock()

    def acquire(self, client: str) -> Lease:
        """Take the rig, or raise LeaseHeldError."""
        with self._lock:
            held = self._current()
            if held is not None:
                raise LeaseHeldError(held, held.until - self._clock())
            identity = secrets.token_urlsafe(24)
            self._lease = Lease(identity, client, self._clock() + self.seconds)
            return self._lease

    def renew(self, identity: str) -> Lease:
        """Take a heart-beat; raises LeaseLapsedError where it comes too late."""
        with self._lock:
            held = self._checked(identity)
            self._lease = replace(held, until=self._clock() + self.seconds)
            return self._lease

    def release(self, identity: str) -> Lease:
        """Give the rig back; raises LeaseLapsedError where it isn't held by this lease."""
        with self._lock:
            released = self._checked(identity)
            self._lease = None
            return released

    def is_held_by(self, identity: str) -> bool:
        """Whether this lease is in force."""
        with self._lock:
            held = self._current()
            return held is not None and secrets.compare_digest(_known(held.id), _known(identity))

    @property
    def current(self) -> Lease | None:
        """The lease in force, if any."""
        with self._lock:
            return self._current()

    def _checked(self, identity: str) -> Lease:
        held = self._current()
        if held is None or not secrets.compare_digest(_known(held.id), _known(identity)):
            raise LeaseLapsedError(
                "this lease is not in force: it lapsed or the server was started anew; acquire "
                "again"
            )
        return held

    def _current(self) -> Lease | None:
        if self._lease is not None and self._lease.until <= self._clock():
            self._lease = None
        return self._lease


def _known(identity: str) -> bytes:
    return identity.encode("utf-8", "surrogatepass")
