"""Program that owns the projector's window: it receives pictures and replies when they are drawn.

SDL must be called by the main thread, and Xlib ends the process when its display is lost, so
neither can run in a server. `rfpipe.devices.window` starts ``python -P window_process.py CONNECTION
SETTINGS``, which ends with the connection. A message has the bytes of a picture to draw, or is
empty to request whether the last picture is undisturbed. A reply is a pair: the window's shape at
first, then a bool; and None or an error message.
"""

import json
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

EVENT_SECONDS = 0.05
"""Interval at which the window's events are handled while no picture arrives."""

DRIVERS = ("x11", "wayland", "windows", "cocoa")
"""SDL's drivers with a visible window; without a display, SDL selects another driver."""

SDL_CENTRED_ON_DISPLAY = 0x2FFF0000
"""SDL_WINDOWPOS_CENTERED_DISPLAY(0)."""


class WindowError(Exception):
    """The window can't be opened, or has been moved or resized."""


class Window:
    """A borderless window over a display or a part of it, drawn in 8-bit grey or colour."""

    def __init__(self, screen: int, offset: tuple[int, int], shape: tuple[int, int] | None) -> None:
        import pygame

        try:
            pygame.display.init()
        except pygame.error as error:
            raise WindowError(f"SDL can't open a display: {error}") from error
        driver = pygame.display.get_driver()
        if driver not in DRIVERS:
            raise WindowError(f"no display is available (SDL selected its driver {driver!r})")
        monitors = pygame.display.get_desktop_sizes()
        if screen >= len(monitors):
            raise WindowError(f"there is no monitor {screen}; this display has {len(monitors)}")
        width, height = monitors[screen]
        rows, columns = shape or (height - offset[0], width - offset[1])
        self.shape = rows, columns
        lower, right = offset[0] + rows, offset[1] + columns
        if min(self.shape) < 1 or lower > height or right > width:
            raise WindowError(
                f"a picture of {self.shape} pixels at {tuple(offset)} doesn't fit on "
                f"monitor {screen}, {(height, width)}"
            )
        centred = (SDL_CENTRED_ON_DISPLAY | screen,) * 2
        full = pygame.Window("rfpipe", (width, height), centred, borderless=True, hidden=True)
        x, y = full.position  # a window as large as the monitor is at the monitor's origin
        full.destroy()
        self._place = (x + offset[1], y + offset[0])
        self._size = self.shape[::-1]
        self._window = pygame.Window(
            "rfpipe", self._size, self._place, borderless=True, always_on_top=True
        )
        pygame.mouse.set_visible(False)
        pygame.display.set_allow_screensaver(False)
        self._surface = self._window.get_surface()
        red, green, blue, _ = self._surface.get_shifts()
        self._units = np.array([1 << red, 1 << green, 1 << blue], np.uint32)
        self._was_hidden = False
        self.draw(np.zeros(self.shape, np.uint8))

    def draw(self, codes: NDArray[np.uint8]) -> None:
        """Draw a picture, (H, W) or (H, W, 3); return when the display server has drawn it."""
        self._check_place()
        height, width = self.shape
        row = self._surface.get_pitch() // 4
        memory: Any = self._surface.get_buffer()
        pixels = np.frombuffer(memory, np.uint32).reshape(height, row)
        if codes.ndim == 2:
            np.multiply(codes, self._units.sum(), out=pixels[:, :width], dtype=np.uint32)
        else:
            np.matmul(codes, self._units, out=pixels[:, :width], dtype=np.uint32)
        self._was_hidden = False
        self._flip()

    def handle_events(self) -> None:
        """Handle events of the window manager, and redraw a picture that was hidden."""
        import pygame

        exposed = pygame.WINDOWEXPOSED, pygame.WINDOWRESTORED, pygame.WINDOWSHOWN
        if any(event.type in exposed for event in pygame.event.get()):
            self._was_hidden = True
            self._flip()

    def is_undisturbed(self) -> bool:
        """Test whether the last picture was in place and visible all the time."""
        self.handle_events()
        self._check_place()
        self._flip()  # ends this process if the display server is lost
        return not self._was_hidden

    def _check_place(self) -> None:
        if self._window.size != self._size or self._window.position != self._place:
            raise WindowError(
                f"the window is {self._window.size} pixels at {self._window.position}, not "
                f"{self._size} at {self._place}: something moved or resized it"
            )

    def _flip(self) -> None:
        import pygame

        self._window.flip()  # on X11 it ends with XSync: the server has drawn the picture
        pygame.event.pump()


def serve(window: Window, connection: Any) -> None:
    """Draw received pictures until the connection ends."""
    connection.send((window.shape, None))
    while True:
        if not connection.poll(EVENT_SECONDS):
            window.handle_events()
            continue
        picture = connection.recv_bytes()
        if picture:
            window.handle_events()
            codes = np.frombuffer(picture, np.uint8)
            colours = () if codes.size == window.shape[0] * window.shape[1] else (3,)
            window.draw(codes.reshape(*window.shape, *colours))
        connection.send((bool(picture) or window.is_undisturbed(), None))


def main() -> None:
    """Open the window of the settings, and serve it."""
    connection: Any = Connection(int(sys.argv[1]))
    with suppress(EOFError, OSError):  # the parent is gone
        try:
            serve(Window(**json.loads(sys.argv[2])), connection)
        except WindowError as error:
            connection.send((None, str(error)))
            sys.exit(1)


if __name__ == "__main__":
    main()
