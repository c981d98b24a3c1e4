"""An X server without a screen, whose pixels can be read."""

from __future__ import annotations

import mmap
import os
import selectors
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.rigs.display import VirtualDisplay

__all__ = ["XServer", "xvfb"]

START_SECONDS = 20.0


class XServer(VirtualDisplay):
    """An X server in memory on a free display number.

    Parameters
    ----------
    shape : (int, int)
        Height and width in pixels.
    until_unused : bool
        Whether the server ends with its last client, so that none stays behind when this process
        is killed.

    Raises
    ------
    CaptureError
        When Xvfb isn't installed or doesn't start.
    """

    def __init__(self, shape: tuple[int, int], *, until_unused: bool = False) -> None:
        self._shape = shape
        self._until_unused = until_unused
        self._process, name, pixels = self._started()
        super().__init__(name, pixels)

    @property
    def pid(self) -> int:
        """Number of the server's process."""
        return self._process.pid

    def revive(self) -> None:
        """Start the server again, under the same name, where it has died."""
        if self._process.poll() is not None:
            self._process, self.name, self.pixels = self._started(self.name)

    def close(self) -> None:
        """End the server; ending it twice is no error."""
        self._process.terminate()
        self._process.wait()

    def _started(
        self, name: str | None = None
    ) -> tuple[subprocess.Popen[bytes], str, NDArray[np.uint8]]:
        """Start a server; return its process, its name and its pixels."""
        program = shutil.which("Xvfb")
        if program is None:
            raise CaptureError("Xvfb isn't installed; on Debian: apt-get install xvfb")
        height, width = self._shape
        read, write = os.pipe()
        with tempfile.TemporaryDirectory(prefix="rfpipe-xvfb-") as folder:
            process = subprocess.Popen(
                [
                    program, *([name] if name else []), "-displayfd", str(write),
                    "-screen", "0", f"{width}x{height}x24",
                    "-fbdir", folder, "-nolisten", "tcp", "-s", "0", "-dpms",
                    "-terminate" if self._until_unused else "-noreset",
                ],
                pass_fds=[write], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )  # fmt: skip
            os.close(write)
            try:
                found = _display_name(read)
                pixels = _pixels(Path(folder) / "Xvfb_screen0", self._shape)
            except BaseException:
                process.terminate()
                process.wait()
                raise
            finally:
                os.close(read)
        # the memory stays mapped without its file, and nothing is left when this process is killed
        return process, found, pixels


@contextmanager
def xvfb(shape: tuple[int, int], *, until_unused: bool = False) -> Iterator[XServer]:
    """Run an X server in memory, as `XServer` does, while a with statement lasts."""
    server = XServer(shape, until_unused=until_unused)
    try:
        yield server
    finally:
        server.close()


def _display_name(descriptor: int) -> str:
    """Read the number that Xvfb writes once it takes clients."""
    number = b""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        # the line's end is a write of its own, and kills the server where nobody reads it
        while not number.endswith(b"\n") and selector.select(START_SECONDS):
            part = os.read(descriptor, 16)
            if not part:
                break
            number += part
    if not number.endswith(b"\n"):
        raise CaptureError(f"Xvfb didn't start within {START_SECONDS:g} s; try it by hand")
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
