"""An X server without a screen, whose pixels can be read."""

from __future__ import annotations

import logging
import mmap
import os
import selectors
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.rigs.display import VirtualDisplay

__all__ = ["XServer"]

START_SECONDS = 60.0

_log = logging.getLogger(__name__)


class _EndedAtOnceError(CaptureError):
    """The server ended before it took clients."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"Xvfb ended when it was started: {reason}")


class XServer(VirtualDisplay):
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
        self._until_unused = until_unused
        self._process, name, pixels = self._started(name)
        super().__init__(name, pixels)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Number of the server's process."""
        return self._process.pid

    def revive(self) -> None:
        """Start the server again where it has died, under the same name if that is still free."""
        if self._process.poll() is None:
            return
        try:
            self._process, self.name, self.pixels = self._started(self.name)
        except _EndedAtOnceError as error:
            _log.warning("%s; trying another display", error)
            self._process, self.name, self.pixels = self._started()

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
        with (
            tempfile.TemporaryDirectory(prefix="rfpipe-xvfb-") as folder,
            (Path(folder) / "log").open("w+b") as log,
        ):
            process = subprocess.Popen(
                [
                    program, *([name] if name else []), "-displayfd", str(write),
                    "-screen", "0", f"{width}x{height}x24",
                    "-fbdir", folder, "-nolisten", "tcp", "-s", "0", "-dpms",
                    "-terminate" if self._until_unused else "-noreset",
                ],
                pass_fds=[write], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log,
            )  # fmt: skip
            os.close(write)
            try:
                found = _display_name(read)
                pixels = _pixels(Path(folder) / "Xvfb_screen0", self._shape)
            except EOFError:
                process.wait()
                raise _EndedAtOnceError(_last_words(log)) from None
            except BaseException:
                process.terminate()
                process.wait()
                raise
            finally:
                os.close(read)
        # the memory stays mapped without its file, and nothing is left when this process is killed
        return process, found, pixels


def _last_words(log: BinaryIO) -> str:
    """Return why Xvfb ended, in its own words."""
    log.seek(0)
    words = log.read().decode(errors="replace").replace("(EE)", "")
    lines = words.rpartition("Fatal server error:")[2].split("\n")
    return next((line.strip() for line in lines if line.strip()), "it gave no reason")


def _display_name(descriptor: int) -> str:
    """Read the number that Xvfb writes once it takes clients; EOFError where it ends before."""
    number = b""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        # the line's end is a write of its own, and kills the server where nobody reads it
        while not number.endswith(b"\n") and selector.select(START_SECONDS):
            part = os.read(descriptor, 16)
            if not part:
                raise EOFError
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
