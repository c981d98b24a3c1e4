"""An X server in memory, with access to its pixels."""

import os
import subprocess
from typing import Any

import numpy as np

OWN_NAME = f":{1000 + os.getpid() % 50_000}"
"""A display that no other test takes while its server is away."""


class XServer:
    """Xvfb as a context manager that stops the server at its end."""

    def __init__(self, shape: tuple[int, int], name: str | None = None) -> None:
        self.shape = shape
        read, write = os.pipe()
        size = f"{shape[1]}x{shape[0]}x24"
        arguments = [*([name] if name else []), "-displayfd", str(write), "-screen", "0", size]
        self._process = subprocess.Popen(
            ["Xvfb", *arguments, "-nolisten", "tcp", "-s", "0", "-dpms", "-noreset"],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as number:
            self.name = f":{int(number.readline())}"

    @property
    def pixels(self) -> np.ndarray:
        """Current blue, green and red of each pixel, uint8 (H, W, 3)."""
        from Xlib import X
        from Xlib.display import Display

        client = Display(self.name)
        height, width = self.shape
        image = client.screen().root.get_image(0, 0, width, height, X.ZPixmap, 0xFFFFFFFF)
        client.close()
        return np.frombuffer(image.data, np.uint8).reshape(height, width, 4)[..., :3]

    def __enter__(self) -> "XServer":
        return self

    def __exit__(self, *_: Any) -> None:
        self._process.kill()
        self._process.wait()
