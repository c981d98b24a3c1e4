"""The projector: a full-screen window, pixel-exact, linear in the pattern."""

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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.config.base import Settings
from rfpipe.errors import CaptureError, InputError
from rfpipe.provenance import fingerprint
from rfpipe.rigs.devices import Closing, Offset, PictureExtent, check_picture, options_of

Float = NDArray[np.float32]
Codes = NDArray[np.uint8]

ANSWER_SECONDS = 20.0
"""Time within which a window opens and a picture is drawn, or the display counts as dead."""

STEPS = 65535
"""Weights are rounded to multiples of 1 / STEPS before they are looked up."""

_log = logging.getLogger(__name__)


class WindowOptions(Settings):
    """The projector: a full-screen window on a display."""

    display: str | None = Field(
        None,
        pattern=r"^\S*:\d+(\.\d+)?$",
        description="X display, such as :0, or null for that of the environment's DISPLAY.",
    )
    screen: int = Field(
        0, ge=0, le=63, description="Number of the monitor on that display, 0 to 63."
    )
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
        description="Wait after a picture was drawn, until the projector shows it, in seconds, 0 "
        "to 60: two or three frames of the display plus the projector's own delay.",
    )
    reopen_seconds: float = Field(
        10.0,
        ge=0,
        le=3600,
        description="How long to try to open the window again when its display is lost, as by a "
        "cable that flickers or an X server that is started again, in seconds, 0 to 3600. A "
        "client of the server that serves the rig then waits for up to capture.patience_seconds.",
    )
    response: str | None = Field(
        None,
        description="Text file with the light of the codes 0 to 255, one number a line, as a "
        "fraction of that of 255; null for that of the calibration, or, without one, light in "
        "proportion to the code.",
    )


def code_table(light: NDArray[Any] | None) -> Codes:
    """Return the code for each of `STEPS` + 1 weights from 0 to 1, uint8.

    `light`, (256,) and never falling, was measured at each code; None where it is in proportion.
    The code of a weight is that whose light, scaled so that code 0 gives 0 and 255 gives 1, is
    nearest. InputError where the table is none.
    """
    measured = np.arange(256.0) if light is None else np.asarray(light, np.float64)
    if measured.shape != (256,) or not np.isfinite(measured).all():
        raise InputError(
            f"projector response: a table of shape {measured.shape}; expected the light of the "
            "codes 0 to 255, 256 finite numbers"
        )
    falls = np.flatnonzero(np.diff(measured) < 0)
    if falls.size or measured[-1] <= measured[0]:
        code = int(falls[0]) + 1 if falls.size else 255
        raise InputError(
            f"projector response: the light of code {code} is {measured[code]:g}, below that of "
            f"code {code - 1}, {measured[code - 1]:g}; light must not fall, and 255 must be "
            "brighter than 0. Measure it again, with the lamp warm"
        )
    relative = (measured - measured[0]) / (measured[-1] - measured[0])
    between = (relative[1:] + relative[:-1]) / 2
    weights = np.arange(STEPS + 1) / STEPS
    return np.searchsorted(between, weights).astype(np.uint8)


def read_response(path: str | Path) -> NDArray[np.float64]:
    """Read a projector's response, one number a line for the codes 0 to 255, or InputError."""
    try:
        light = np.loadtxt(path, dtype=np.float64, ndmin=1)
        code_table(light)
    except (OSError, ValueError) as error:  # InputError is a ValueError, too
        raise InputError(f"{path}: can't be read as a projector's response: {error}") from error
    return light


class _LostWindowError(CaptureError):
    """The window, or its display, is gone; `reason` says so without advice."""

    def __init__(self, display: str | None, reason: str) -> None:
        self.reason = reason
        super().__init__(
            f"projector on display {display or 'unset'}: {reason}. Check that the "
            "projector is a monitor of this display, and set projector.display, screen, offset "
            "and shape, or the environment's DISPLAY (and XAUTHORITY), accordingly"
        )


class WindowProjector(Closing):
    """A projector as a monitor: a borderless window with one pixel for each of its pixels.

    The window lives in a process of its own (`rfpipe.rigs.window_process`), so `show` may be
    called from any thread, and the loss of the display is an error instead of the process' end.
    A window that is lost is opened again, for `reopen_seconds` and then at each further picture:
    a display that comes back goes on. `show` returns after the display's server has confirmed
    that it drew the picture (on X11 by XSync) and after `settle_seconds`. When the light then
    leaves the lens is known to the projector alone: calibration's step *latency* measures it.

    Parameters
    ----------
    display : str, optional
    response : ndarray, shape (256,), or path, optional
        Light measured at each code, see `code_table`, or a file of it, see `read_response`.
    options
        As `WindowOptions` has them, by name, the same where they aren't given.

    Attributes
    ----------
    statistics : dict of str to int
        ``shown``: pictures; ``reopened``: times that the window was lost and opened again;
        ``disturbed``: pictures of which `undisturbed` was told that they didn't stand.

    Raises
    ------
    CaptureError
        When the window can't be opened: says what to set.
    InputError
        When the response is none.
    """

    Options = WindowOptions

    def __init__(
        self,
        display: str | None = None,
        *,
        response: NDArray[Any] | str | Path | None = None,
        **options: Any,
    ) -> None:
        chosen = options_of(self, options)
        light = read_response(response) if isinstance(response, str | Path) else response
        self._codes = code_table(light)
        self._display = display
        self._settings = chosen.model_dump(include={"screen", "offset", "shape"}, mode="json")
        self.settle_seconds = chosen.settle_seconds
        self._reopen_seconds = chosen.reopen_seconds
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._lost: _LostWindowError | None = None
        self.statistics = {"shown": 0, "reopened": 0, "disturbed": 0}
        self._window: Any = self._open()
        self.shape: tuple[int, int] = self._window.shape

    def show(self, picture: Float) -> None:
        """Show a picture; see `rfpipe.rigs.devices.Projector.show`."""
        self.show_now(picture)
        time.sleep(self.settle_seconds)

    def show_now(self, picture: Float) -> None:
        """Show a picture, and return when it is drawn; see `rfpipe.rigs.devices.Projector`."""
        picture = check_picture(picture, self.shape)
        codes = self._codes[np.rint(picture * np.float32(STEPS)).astype(np.uint16)]
        with self._lock:
            self._draw(codes)
            self.statistics["shown"] += 1

    def undisturbed(self) -> bool:
        """Whether the last picture stood until now; see `rfpipe.rigs.devices.Projector`."""
        with self._lock:
            try:
                stood = self._window is not None and bool(self._window.is_undisturbed())
            except _LostWindowError as error:
                self._lose(error)
                stood = False
            self.statistics["disturbed"] += not stood
        return stood

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
        self._closing.set()
        with self._lock:
            self._drop()

    def _open(self) -> Any:
        """Return a new window."""
        return _WindowProcess(self._display, self._settings)

    def _draw(self, codes: Codes) -> None:
        """Draw a picture, in a window opened again where it is lost."""
        end, pause = time.monotonic() + self._reopen_seconds, 0.2
        while not self._closing.is_set():
            try:
                if self._window is None:
                    self._window = self._open()
                    if self._window.shape != self.shape:
                        raise _LostWindowError(
                            self._display,
                            f"the projector's monitor has {self._window.shape} pixels now, "
                            f"{self.shape} before; set its resolution back",
                        )
                self._window.draw(codes)
            except _LostWindowError as error:
                first = self._lose(error)  # which explains most
                if time.monotonic() >= end:
                    raise _LostWindowError(
                        self._display,
                        f"{first}; tried to open it again for {self._reopen_seconds:g} s "
                        "(reopen_seconds)",
                    ) from error
                self._closing.wait(min(pause, end - time.monotonic()))
                pause = min(2 * pause, 5.0)
                continue
            if self._lost is not None:
                self._lost = None
                self.statistics["reopened"] += 1
                _log.warning("projector: the window is open again; going on")
            return
        raise CaptureError("the projector's window is closed; open it anew")

    def _lose(self, error: _LostWindowError) -> str:
        """Let go of a lost window; return the reason of the first loss since it stood."""
        if self._lost is None:
            self._lost = error
            _log.warning(
                "%s. Opening the window again, for up to %g s", error, self._reopen_seconds
            )
        self._drop()
        return self._lost.reason

    def _drop(self) -> None:
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
        self._connection, theirs = multiprocessing.Pipe()
        program = Path(__file__).with_name("window_process.py")
        self._process = subprocess.Popen(
            # -P: modules of rfpipe.rigs beside the program are no top-level ones
            [sys.executable, "-P", str(program), str(theirs.fileno()), json.dumps(settings)],
            pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=self._errors,
            stderr=self._errors, env=environment,
        )  # fmt: skip
        theirs.close()
        try:
            self.shape: tuple[int, int] = self._asked(None)
        except BaseException:
            self.close()
            raise

    def draw(self, codes: Codes) -> None:
        """Send a picture, and wait until it is drawn."""
        self._asked(codes.tobytes())

    def is_undisturbed(self) -> bool:
        """Ask whether the last picture stood where it was drawn, and nothing hid it."""
        return bool(self._asked(b""))

    def close(self) -> None:
        """End the process, which closes the window."""
        self._connection.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._errors.close()

    def _asked(self, message: bytes | None) -> Any:
        """Send a message, if there is one, and return the answer."""
        try:
            if message is not None:
                self._connection.send_bytes(message)
            if not self._connection.poll(ANSWER_SECONDS):
                raise self._failure(f"the display gave no answer within {ANSWER_SECONDS:g} s")
            answer, problem = self._connection.recv()
        except (EOFError, OSError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=1)  # its last words are then said
            raise self._failure("the projector's window is gone") from None
        if problem:
            raise self._failure(problem)
        return answer

    def _failure(self, what: str) -> _LostWindowError:
        """Return the error of a problem, with the last lines of the window's process."""
        self._errors.seek(0)
        words = self._errors.read().decode(errors="replace").strip().splitlines()[-2:]
        detail = f" ({' '.join(' '.join(words).split())})" if words else ""
        return _LostWindowError(self._display, f"{what}{detail}")
