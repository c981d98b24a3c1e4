"""Progress of long computations: the computation counts its steps, a caller may display them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any

_factory: ContextVar[Any] = ContextVar("factory", default=None)
"""Callable that makes the progress bar of a computation, or None."""

_progress_bar: ContextVar[Any] = ContextVar("progress_bar", default=None)
"""Progress bar of the running computation, or None."""


@contextmanager
def displayed_by(factory: Callable[[str, int], AbstractContextManager[Any]]) -> Iterator[None]:
    """Display the progress of the computations in a ``with`` block.

    Parameters
    ----------
    factory : callable
        ``factory(name, total)`` returns a progress bar, a context manager whose value has a
        method ``advance(steps)``.
    """
    previous = _factory.set(factory)
    try:
        yield
    finally:
        _factory.reset(previous)


@contextmanager
def steps(name: str, total: int) -> Iterator[None]:
    """Enclose a computation of `total` steps, which calls `step` after each of them."""
    factory = _factory.get()
    if factory is None:
        yield
        return
    with factory(name, total) as progress_bar:
        previous = _progress_bar.set(progress_bar)
        try:
            yield
        finally:
            _progress_bar.reset(previous)


def step() -> None:
    """Count a step of the running computation, if its progress is displayed."""
    progress_bar = _progress_bar.get()
    if progress_bar is not None:
        progress_bar.advance(1)
