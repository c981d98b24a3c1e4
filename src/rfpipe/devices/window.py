"""A projector as a full-screen window: pixel-exact, light linear in the pattern."""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.array_types import Codes, Float
from rfpipe.config.base import Settings
from rfpipe.errors import CaptureError
from rfpipe.installation import installing
from rfpipe.provenance import fingerprint
from rfpipe.rigs.devices import (
    WEIGHT_STEPS,
    Closing,
    Offset,
    PictureExtent,
    check_picture,
    code_table,
)

ANSWER_SECONDS = 20.0
"""Timeout for opening a window and for drawing a picture."""

_log = logging.getLogger(__name__)


class WindowOptions(Settings):
    """A projector as a full-screen window on a display."""

    display: str | None = Field(
        None,
        pattern=r"^\S*:\d+(\.\d+)?$",
        description="X display, such as :0, or null for the environment's DISPLAY.",
    )
    screen: int = Field(0, ge=0, le=63, description="Number of the monitor on that display.")
    offset: tuple[Offset, Offset] = Field(
        (0, 0),
        description="Place of the picture on the monitor: pixels from its upper edge and from "
        "its left edge.",
    )
    shape: tuple[PictureExtent, PictureExtent] | None = Field(
        None,
        description="Height and width of the picture in pixels, or null for the whole monitor. "
        "Set the monitor to the projector's native resolution.",
    )
    settle_seconds: float = Field(
        0.1,
        ge=0,
        le=60,
        description="Wait between drawing a picture and its appearance in seconds: two or three "
        "frames of the display plus the delay of the projector.",
    )


class _LostWindowError(CaptureError):
    """The window or its display is lost."""

    def __init__(self, display: str | None, reason: str) -> None:
        super().__init__(
            f"projector on display {display or 'unset'}: {reason}. Check that the "
            "projector is a monitor of this display, and set projector.options.display, screen, "
            "offset and shape, or the environment's DISPLAY (and XAUTHORITY), accordingly"
        )


def _check_requirements() -> None:
    """Raise CaptureError without pygame, or where a process can't inherit a connection."""
    if find_spec("pygame") is None:
        raise CaptureError("the driver window needs pygame", remedy=installing("rig"))
    if sys.platform == "win32":
        raise CaptureError(
            "the driver window doesn't run on Windows",
            remedy="Connect projector and camera to a machine with Linux or macOS, or write a "
            "driver (docs/devices.md)",
        )


class WindowProjector(Closing):
    """A projector connected as a monitor: a borderless window, one pixel per projector pixel.

    A separate process (`rfpipe.devices.window_process`) owns the window, so `show` may be called
    from any thread, and losing the display raises an error instead of ending this process. A lost
    window is opened again for the next picture. `show` returns `settle_seconds` after the display
    server has confirmed that it drew the picture (on X11 by XSync); the calibration step *latency*
    measures when its light appears.

    Parameters
    ----------
    display : str, optional
    response : ndarray, shape (256,), optional
        Light measured at each code, see `code_table`.
    options
        By name, with defaults, as in `WindowOptions`.

    `statistics` counts pictures ``shown``, how often the window was ``reopened``, and pictures that
    `undisturbed` found ``disturbed``.

    Raises
    ------
    CaptureError
        When the window can't be opened; names the settings to check.
    InputError
        When the response isn't valid.
    """

    Options = WindowOptions

    def __init__(
        self,
        display: str | None = None,
        *,
        response: NDArray[Any] | None = None,
        **options: Any,
    ) -> None:
        _check_requirements()
        selected = WindowOptions(**options)
        self._codes = code_table(response)
        self._display = display
        self._settings = selected.model_dump(include={"screen", "offset", "shape"}, mode="json")
        self.settle_seconds = selected.settle_seconds
        self._lock = threading.Lock()
        self._is_closed = False
        self.statistics = {"shown": 0, "reopened": 0, "disturbed": 0}
        self._window: Any = self._open()
        self.shape: tuple[int, int] = self._window.shape

    def show(self, picture: Float) -> None:
        """Show a picture; see `rfpipe.rigs.devices.Projector.show`."""
        self.show_now(picture)
        time.sleep(self.settle_seconds)

    def show_now(self, picture: Float) -> None:
        """Show a picture without waiting for its light; see `rfpipe.rigs.devices.Projector`."""
        self._show(check_picture(picture, self.shape))

    def show_colour(self, picture: Float) -> None:
        """Show weights (H, W, 3) of red, green and blue; see `rfpipe.rigs.devices.Projector`."""
        self._show(check_picture(picture, (*self.shape, 3)))
        time.sleep(self.settle_seconds)

    def _show(self, picture: Float) -> None:
        codes = self._codes[np.rint(picture * np.float32(WEIGHT_STEPS)).astype(np.uint16)]
        with self._lock:
            self._draw(codes)
            self.statistics["shown"] += 1

    def undisturbed(self) -> bool:
        """True if the last picture is still displayed; see `rfpipe.rigs.devices.Projector`."""
        with self._lock:
            try:
                is_undisturbed = self._window is not None and bool(self._window.is_undisturbed())
            except _LostWindowError as error:
                _log.warning("%s", error)
                self._disconnect()
                is_undisturbed = False
            self.statistics["disturbed"] += not is_undisturbed
        return is_undisturbed

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the light."""
        return {
            "kind": "window",
            "shape": list(self.shape),
            "offset": self._settings["offset"],
            "codes": fingerprint(self._codes),
        }

    def close(self) -> None:
        """Close the window; closing twice is no error."""
        with self._lock:
            self._is_closed = True
            self._disconnect()

    def _open(self) -> Any:
        """Open a new window."""
        return _WindowProcess(self._display, self._settings)

    def _draw(self, codes: Codes) -> None:
        """Draw a picture, after opening a lost window again."""
        if self._is_closed:
            raise CaptureError("the projector's window is closed; open it again")
        if self._window is not None:
            try:
                self._window.draw(codes)
                return
            except _LostWindowError as error:
                _log.warning("%s. Opening the window again", error)
                self._disconnect()
        self._window = self._open()
        if self._window.shape != self.shape:
            shape = self._window.shape
            self._disconnect()
            raise _LostWindowError(
                self._display,
                f"the projector's monitor has {shape} pixels now, {self.shape} before; restore its "
                "resolution",
            )
        self._window.draw(codes)
        self.statistics["reopened"] += 1

    def _disconnect(self) -> None:
        window, self._window = self._window, None
        if window is not None:
            window.close()


class _WindowProcess:
    """The process that owns the window."""

    def __init__(self, display: str | None, settings: dict[str, Any]) -> None:
        environment = dict(os.environ, PYGAME_HIDE_SUPPORT_PROMPT="1")
        if display is not None:
            environment["DISPLAY"] = display
        self._display = environment.get("DISPLAY")
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        self._connection, child_end = multiprocessing.Pipe()
        program = Path(__file__).with_name("window_process.py")
        self._process = subprocess.Popen(
            # -P: the program's folder isn't added to sys.path
            [sys.executable, "-P", str(program), str(child_end.fileno()), json.dumps(settings)],
            pass_fds=[child_end.fileno()], stdin=subprocess.DEVNULL, stdout=self._errors,
            stderr=self._errors, env=environment,
            process_group=0,  # Ctrl-C reaches only this process, which closes the connection
        )  # fmt: skip
        child_end.close()
        try:
            self.shape: tuple[int, int] = self._request(None)
        except BaseException:
            self.close()
            raise

    def draw(self, codes: Codes) -> None:
        """Send a picture, and wait until it is drawn."""
        self._request(codes.tobytes())

    def is_undisturbed(self) -> bool:
        """Test whether the last picture was in place and visible all the time."""
        return bool(self._request(b""))

    def close(self) -> None:
        """End the process, which closes the window."""
        self._connection.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._errors.close()

    def _request(self, message: bytes | None) -> Any:
        """Send a message, unless it is None, and return the reply."""
        try:
            if message is not None:
                self._connection.send_bytes(message)
            if not self._connection.poll(ANSWER_SECONDS):
                raise self._failure(f"no reply from the display within {ANSWER_SECONDS:g} s")
            reply, problem = self._connection.recv()
        except (EOFError, OSError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=1)  # so that its last output is complete
            raise self._failure("the projector's window is lost") from None
        if problem:
            raise self._failure(problem)
        return reply

    def _failure(self, problem: str) -> _LostWindowError:
        """Return an error with the last lines of output of the window's process."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()[-2:]
        detail = f" ({' '.join(' '.join(lines).split())})" if lines else ""
        return _LostWindowError(self._display, f"{problem}{detail}")
