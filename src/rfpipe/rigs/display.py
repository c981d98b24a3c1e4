"""Displays whose pixels can be read: of an X server without a screen, or a mere array."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError

__all__ = ["VirtualDisplay", "memory_display"]


@dataclass(eq=False)
class VirtualDisplay:
    """A display without a screen.

    Parameters
    ----------
    name : str
        Its name for `rfpipe.rigs.window.WindowProjector`: ``":7"`` of an X server,
        ``"memory:FILE"`` of an array.
    pixels : ndarray of uint8, shape (H, W, 3)
        Blue, green and red of each pixel as they stand now: a view of the display's memory.
    """

    name: str
    pixels: NDArray[np.uint8]

    def revive(self) -> None:
        """Start again what makes the display, where it has died; a mere array doesn't."""


@contextmanager
def memory_display(shape: tuple[int, int]) -> Iterator[VirtualDisplay]:
    """Make a display that needs no server: an array in a file, mapped by all who look at it.

    Its window is a part of the array, drawn by the same process in the same words as one of an X
    server. It has one monitor and no other windows.

    Parameters
    ----------
    shape : (int, int)
        Height and width in pixels.

    Yields
    ------
    VirtualDisplay

    Raises
    ------
    CaptureError
        When the file can't be written.
    """
    with tempfile.TemporaryDirectory(prefix="rfpipe-display-") as folder:
        path = Path(folder) / "pixels.npy"
        try:  # all bytes at once: a map of a file with holes ends the process on a full disk
            np.save(path, np.zeros((*shape, 3), np.uint8))
            pixels = np.asarray(np.load(path, mmap_mode="r"))
        except OSError as error:
            raise CaptureError(
                f"{path}: the display in memory can't be made: {error}. Free space, or set TMPDIR "
                "to a folder with some"
            ) from error
        yield VirtualDisplay(f"memory:{path}", pixels)
