"""Waiting for what another process does."""

import time
from collections.abc import Callable
from typing import Any

PATIENCE_SECONDS = 240.0  # of a machine that others use, too


def wait_until(condition: Callable[[], Any], what: str, every: float = 0.001) -> Any:
    """Wait for something to become true, and return it; look every so many seconds."""
    end = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < end:
        result = condition()
        if result:
            return result
        time.sleep(every)
    raise AssertionError(f"{what}: not within {PATIENCE_SECONDS} s")
