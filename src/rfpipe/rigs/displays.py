"""Displays whose pixels can be read: of an X server without a screen, or a mere array."""

from __future__ import annotations

import logging
import mmap
import os
import selectors
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.rigs.devices import Closing

_START_SECONDS = 60.0
"""Time within which Xvfb starts, on a machine that others keep busy."""

_log = logging.getLogger(__name__)


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
        """Start the display's server again where it has died; an array has none."""


@contextmanager
def memory_display(shape: tuple[int, int]) -> Iterator[VirtualDisplay]:
    """Make a display that needs no server: an array (H, W) in a file, mapped by all who look at it.

    Its window is a part of the array, drawn by the same process in the same words as one of an X
    server. It has one monitor and no other windows.

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


class XServer(VirtualDisplay, Closing):
    """An X server in memory, which ends with the ``with`` statement that it is used in.

    Parameters
    ----------
    shape : (int, int)
        Height and width in pixels.
    until_unused : bool
        Whether the server ends with its last client, so that none stays behind when this process
        is killed.
    name : str, optional
        Such as ``":4711"``, which `revive` keeps unless another server has it by then; low numbers
        are taken soonest. None takes the lowest free one.

    Raises
    ------
    CaptureError
        When Xvfb isn't installed or doesn't start.
    """

    def __init__(
        self, shape: tuple[int, int], *, until_unused: bool = False, name: str | None = None
    ) -> None:
        self._shape = shape
        self._ending = "-terminate" if until_unused else "-noreset"
        self._start(name)

    @property
    def pid(self) -> int:
        """Number of the server's process."""
        return self._process.pid

    def revive(self) -> None:
        """Start the server again where it has died, under the same name if that is still free."""
        if self._process.poll() is None:
            return
        try:
            self._start(self.name)
        except _EndedAtOnceError as error:
            _log.warning("%s; trying another display", error)
            self._start(None)

    def close(self) -> None:
        """End the server; ending it twice is no error."""
        self._process.terminate()
        self._process.wait()

    def _start(self, name: str | None) -> None:
        program = shutil.which("Xvfb")
        if program is None:
            raise CaptureError("Xvfb isn't installed; on Debian: apt-get install xvfb")
        height, width = self._shape
        read, write = os.pipe()
        with (
            tempfile.TemporaryDirectory(prefix="rfpipe-xvfb-") as folder,
            (Path(folder) / "log").open("w+b") as log,
        ):
            process = subprocess.Popen(
                [
                    program, *([name] if name else []), "-displayfd", str(write),
                    "-screen", "0", f"{width}x{height}x24", "-fbdir", folder,
                    "-nolisten", "tcp", "-s", "0", "-dpms", self._ending,
                ],
                pass_fds=[write], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log,
            )  # fmt: skip
            os.close(write)
            try:
                self.name = _display_name(read)
                # the memory stays mapped without its file: nothing is left after a kill
                self.pixels = _pixels(Path(folder) / "Xvfb_screen0", self._shape)
            except BaseException as error:
                process.terminate()
                process.wait()
                if isinstance(error, EOFError):
                    log.seek(0)
                    words = log.read().decode(errors="replace").replace("(EE)", "")
                    words = words.rpartition("Fatal server error:")[2].strip()
                    raise _EndedAtOnceError(
                        f"Xvfb ended when it was started: {words.split(chr(10))[0].strip()}"
                    ) from None
                raise
            finally:
                os.close(read)
        self._process = process


class _EndedAtOnceError(CaptureError):
    """The server ended before it took clients."""


def _display_name(descriptor: int) -> str:
    """Read the number that Xvfb writes once it takes clients; EOFError where it ends before."""
    number = b""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        # the line's end is a write of its own, and kills the server where nobody reads it
        while not number.endswith(b"\n"):
            if not selector.select(_START_SECONDS):
                raise CaptureError(f"Xvfb didn't start within {_START_SECONDS:g} s; try it by hand")
            part = os.read(descriptor, 16)
            if not part:
                raise EOFError
            number += part
    return f":{int(number)}"


def _pixels(path: Path, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Map the server's picture, an XWD file: a header of big-endian words, colours, then rows."""
    with path.open("rb") as file:
        memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    words = struct.unpack(">25I", memory[:100])
    header_bytes, bits, row_bytes, colours = words[0], words[11], words[12], words[19]
    if bits != 32:
        raise CaptureError(f"Xvfb keeps {bits} bits a pixel; expected 32")
    start = header_bytes + 12 * colours
    height, width = shape
    rows = np.frombuffer(memory, np.uint8, height * row_bytes, start).reshape(height, row_bytes)
    return rows[:, : 4 * width].reshape(height, width, 4)[..., :3]
