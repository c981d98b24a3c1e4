"""The frames of a sequence, fetched from a camera while a projector triggers it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["Collector"]

Counts = NDArray[np.uint16]

POLL_SECONDS = 0.1

QUEUE = 32
"""Frames that a camera's library has room for at once."""


class Collector:
    """Fetches frames as they come, so that the driver never runs out of buffers.

    Parameters
    ----------
    take : callable
        ``take(seconds)`` returns the next frame and ``""``, or None and what is wrong with it; None
        and ``""`` where none came. It is no one else's until `finish`.
    expect : callable
        Makes room for one more frame.
    faults : tuple of exception types
        That `take` raises where the camera is lost.
    count : int
        Frames to come.
    patience : float
        Seconds without a frame after which no more is waited for, once the sequence is over.
    """

    def __init__(
        self,
        take: Callable[[float], tuple[Counts | None, str]],
        expect: Callable[[], None],
        faults: tuple[type[Exception], ...],
        count: int,
        patience: float,
    ) -> None:
        self.count = count
        self._take, self._expect, self._faults = take, expect, faults
        self._patience = patience
        self._frames: list[Counts] = []
        self._failed = 0
        self._room = min(count, QUEUE)
        for _ in range(self._room):
            expect()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._fetch, name="frames", daemon=True)
        self._thread.start()

    def finish(self, *, wait: bool = True) -> tuple[list[Counts], int]:
        """Wait for what still comes; return the good frames and the number of damaged ones."""
        if not wait:
            self._patience = 0.0
        self._is_over.set()
        self._thread.join()
        return self._frames, self._failed

    def _fetch(self) -> None:
        quiet = 0.0
        while len(self._frames) + self._failed < self.count:
            try:
                frame, problem = self._take(POLL_SECONDS)
                if frame is None and not problem:
                    quiet += POLL_SECONDS
                    if self._is_over.is_set() and quiet >= self._patience:
                        return
                    continue
                if self._room < self.count:
                    self._expect()
                    self._room += 1
            except self._faults:
                return  # the camera is lost: what is missing is played again
            quiet = 0.0
            if frame is None:
                self._failed += 1
            else:
                self._frames.append(frame)
