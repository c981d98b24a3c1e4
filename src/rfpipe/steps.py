"""Steps of long computations, counted by whoever shows their progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any

_counter: ContextVar[Any] = ContextVar("counter", default=None)
_counting: ContextVar[Any] = ContextVar("counting", default=None)


@contextmanager
def counted_by(counter: Callable[[str, int], AbstractContextManager[Any]]) -> Iterator[None]:
    """Show computations meanwhile: ``counter(name, steps)`` makes what has ``advance(steps)``."""
    before = _counter.set(counter)
    try:
        yield
    finally:
        _counter.reset(before)


@contextmanager
def steps(name: str, total: int) -> Iterator[None]:
    """Begin a computation of so many steps; each calls `step` at its end."""
    counter = _counter.get()
    if counter is None:
        yield
        return
    with counter(name, total) as counting:
        before = _counting.set(counting)
        try:
            yield
        finally:
            _counting.reset(before)


def step() -> None:
    """Count a step of the computation that has begun, if it is shown."""
    counting = _counting.get()
    if counting is not None:
        counting.advance(1)
