"""Work that any process can load, since this module imports next to nothing."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SHAPE = (8, 10)


@dataclass(frozen=True)
class Dying:
    """Kills its process, as -9 does, the first time that it comes to a piece."""

    work: Any
    at: int
    flag: Path

    def __call__(self, first: int, last: int) -> Any:
        if first == self.at and not self.flag.exists():
            self.flag.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return self.work(first, last)


def identity(first: int, last: int) -> tuple[int, int, int]:
    return os.getpid(), first, last


def slow(first: int, last: int) -> int:
    time.sleep(300)
    return first
