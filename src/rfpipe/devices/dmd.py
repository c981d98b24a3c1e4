"""Base class of projectors with micromirrors (DMD), which are on or off."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Codes, Float
from rfpipe.errors import CaptureError, InputError
from rfpipe.rigs.devices import Closing, check_picture

GREY_BITS = 8
"""Bits of a grey picture; mirrors are on for a time proportional to its code."""


class DmdProjector(Closing, ABC):
    """A projector of 8-bit pictures, and of sequences of binary pictures that trigger the camera.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of mirrors.
    settle_seconds : float
        Wait after a picture is shown.
    sequence_pictures : int
        Largest number of pictures in a sequence.
    sequence_levels : int
        Number of grey levels of a picture in a sequence: 0 and 1.
    """

    sequence_levels = 2

    shape: tuple[int, int]
    sequence_pictures: int

    def __init__(self, settle_seconds: float) -> None:
        self.settle_seconds = settle_seconds
        self._lock = threading.Lock()
        self._is_closed = False

    def show(self, picture: Float) -> None:
        """Show a picture; see `rfpipe.rigs.devices.Projector.show`."""
        self.show_now(picture)
        time.sleep(self.settle_seconds)

    def show_now(self, picture: Float) -> None:
        """Show a picture without waiting for it; see `rfpipe.rigs.devices.Projector`."""
        picture = check_picture(picture, self.shape)
        bits = 1 if ((picture == 0) | (picture == 1)).all() else GREY_BITS
        codes = np.rint((2**bits - 1) * picture).astype(np.uint8)
        with self._lock:
            self._check_open()
            self._show(codes, bits)

    def load(self, pictures: Iterable[Float]) -> None:
        """Load the pictures of a sequence; see `rfpipe.rigs.devices.SequenceProjector`."""
        with self._lock:
            self._check_open()
            self._load(self._bits_of(pictures))

    def play(self, order: Sequence[int], seconds: float) -> None:
        """Show a sequence; see `rfpipe.rigs.devices.SequenceProjector`."""
        microseconds = int(np.ceil(1e6 * seconds))
        with self._lock:
            self._check_open()
            least, longest = self._microseconds()
            if not least <= microseconds <= longest:
                raise CaptureError(
                    f"projector: shows a picture of a sequence for {least} us to "
                    f"{longest / 1e6:.1f} s, not for {seconds:g} s"
                )
            self._play(order, microseconds)

    def close(self) -> None:
        """Stop the display and close the device; closing twice is no error."""
        with self._lock:
            if not self._is_closed:
                self._is_closed = True
                self._release()

    @abstractmethod
    def _show(self, codes: Codes, bits: int) -> None:
        """Show codes (H, W) of 1 or `GREY_BITS` bits until the next picture."""

    @abstractmethod
    def _load(self, pictures: Iterator[NDArray[np.bool_]]) -> None:
        """Load the pictures (H, W) of a sequence."""

    @abstractmethod
    def _microseconds(self) -> tuple[int, int]:
        """Return the shortest and the longest display time in a sequence."""

    @abstractmethod
    def _play(self, order: Sequence[int], microseconds: int) -> None:
        """Show loaded pictures in this order, and return after the last one."""

    @abstractmethod
    def _release(self) -> None:
        """Stop the display and close the device, whatever its state."""

    def _check_open(self) -> None:
        if self._is_closed:
            raise CaptureError("the projector is closed; open it again")

    def _bits_of(self, pictures: Iterable[Float]) -> Iterator[NDArray[np.bool_]]:
        """Convert pictures of a sequence to bits, or raise InputError."""
        for index, picture in enumerate(pictures):
            if index == self.sequence_pictures:
                raise InputError(f"the projector holds at most {index} pictures; more were given")
            weights = check_picture(picture, self.shape)
            lit = weights == 1
            grey = ~lit & (weights != 0)
            if grey.any():
                pixel = tuple(int(i) for i in np.argwhere(grey)[0])
                raise InputError(
                    f"picture {index} is {weights[pixel]:g} at projector pixel {pixel}; sequences "
                    "of this projector have the values 0 and 1 only"
                )
            yield np.asarray(lit)
