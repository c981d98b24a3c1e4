"""What the suites share."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np


class _Described(Protocol):
    def describe(self) -> dict[str, Any]: ...


def require(holds: bool | np.bool_, message: str) -> None:
    """Raise AssertionError unless something holds, also where Python drops assert statements."""
    if not holds:
        raise AssertionError(message)


def require_raises(kind: type[Exception], call: Callable[[], Any], message: str) -> str:
    """Return the message with which a call fails; raise AssertionError where it doesn't."""
    try:
        call()
    except kind as error:
        return str(error)
    raise AssertionError(f"{message} without raising {kind.__name__}")


def require_equal_descriptions(make: Callable[[], AbstractContextManager[_Described]]) -> None:
    """Raise AssertionError unless what is made twice describes itself alike, in plain data."""
    described = []
    for _ in range(2):
        with make() as made:
            described.append(json.dumps(made.describe(), sort_keys=True))
    require(described[0] == described[1], f"describe() differs for what is made again: {described}")
