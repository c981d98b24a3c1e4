"""Waiting for what may come back: how long, and what is told meanwhile."""

from __future__ import annotations

import logging
import threading
import time

from rfpipe.errors import CaptureError

__all__ = ["Patience"]

_FIRST_PAUSE_SECONDS = 0.1
_LONGEST_PAUSE_SECONDS = 5.0
_REMIND_SECONDS = 30.0

_log = logging.getLogger(__name__)


class Patience:
    """Waits between attempts, longer each time, until they have failed for too long.

    Parameters
    ----------
    name : str
        Of what is waited for.
    seconds : float
        How long to wait in all, at least 0.
    closing : threading.Event
        Ends a wait.
    """

    def __init__(self, name: str, seconds: float, closing: threading.Event) -> None:
        self._name = name
        self._seconds = seconds
        self._closing = closing
        self._since: float | None = None
        self._first = ""
        self._reminded = 0.0
        self._pause = _FIRST_PAUSE_SECONDS

    @property
    def is_tried(self) -> bool:
        """Whether attempts have failed since the last success."""
        return self._since is not None

    def end(self) -> None:
        """Note a success."""
        self._since = None

    def pause(self, reason: str) -> None:
        """Wait a little before the next attempt; tell why from time to time.

        Raises
        ------
        CaptureError
            When the patience is at its end: says why the first attempt failed, which explains
            most, and the last one, where that differs.
        """
        now = time.monotonic()
        if self._since is None:
            self._since, self._pause, self._first = now, _FIRST_PAUSE_SECONDS, reason
            self._reminded = now
            _log.warning("%s: %s; waiting for up to %g s", self._name, reason, self._seconds)
        waited = now - self._since
        if waited >= self._seconds:
            last = "" if reason == self._first else f". At last: {reason}"
            raise CaptureError(
                f"{self._name}: {self._first}{last}. Waited for {waited:.0f} s "
                "(capture.patience_seconds); what is captured is kept: run again when that is "
                "mended"
            )
        if now - self._reminded >= _REMIND_SECONDS:
            self._reminded = now
            _log.warning("%s: %s; waiting since %.0f s", self._name, reason, waited)
        self._closing.wait(min(self._pause, self._seconds - waited))
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_SECONDS)
