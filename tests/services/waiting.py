"""Waiting for a condition that another process or thread fulfils."""

import time
from collections.abc import Callable
from typing import Any

PATIENCE_SECONDS = 240.0  # generous, since the machine may be busy


def wait_until(condition: Callable[[], Any], what: str, every: float = 0.001) -> Any:
    """Return the first true value of `condition`, evaluated every `every` seconds."""
    end = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < end:
        result = condition()
        if result:
            return result
        time.sleep(every)
    raise AssertionError(f"{what}: not within {PATIENCE_SECONDS} s")
