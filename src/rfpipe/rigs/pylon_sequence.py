"""The frames of a sequence, fetched from a Basler camera while a projector triggers it."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs.pylon_setup import load_pylon

__all__ = ["Collector"]

Counts = NDArray[np.uint16]

_POLL_MILLISECONDS = 100


class Collector:
    """Fetches frames as they come, so that the driver never runs out of buffers.

    Parameters
    ----------
    camera : pypylon.pylon.InstantCamera
        Grabbing; is no one else's until `finish`.
    count : int
        Frames to come.
    patience : float
        Seconds without a frame after which no more is waited for, once the sequence is over.
    """

    def __init__(self, camera: Any, count: int, patience: float) -> None:
        self.count = count
        self._camera = camera
        self._patience = patience
        self._frames: list[Counts] = []
        self._failed = 0
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._fetch, name="frames", daemon=True)
        self._thread.start()

    def finish(self) -> tuple[list[Counts], int]:
        """Wait for what still comes; return the good frames and the number of damaged ones."""
        self._is_over.set()
        self._thread.join()
        return self._frames, self._failed

    def _fetch(self) -> None:
        pylon, genicam = load_pylon()
        quiet = 0.0
        while len(self._frames) + self._failed < self.count:
            try:
                with self._camera.RetrieveResult(
                    _POLL_MILLISECONDS, pylon.TimeoutHandling_Return
                ) as result:
                    if not result.IsValid():
                        quiet += _POLL_MILLISECONDS / 1000
                        if self._is_over.is_set() and quiet >= self._patience:
                            return
                        continue
                    quiet = 0.0
                    if result.GrabSucceeded():
                        self._frames.append(np.array(result.GetArray(), np.uint16))
                    else:
                        self._failed += 1
            except genicam.GenericException:
                return  # the camera is lost: what is missing is played again
