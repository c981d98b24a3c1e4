"""What the report knows of methods: their names in words, and how they are drawn.

Methods describe themselves; no other module of the report names one.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from rfpipe import plugins
from rfpipe.errors import InputError
from rfpipe.report.text import words

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = [
    "colour",
    "know",
    "listed",
    "style",
    "swatches",
    "title",
]

_GREY = "#6b6b6b"


_OF_SECTION: dict[str, str] = {}
"""What the sections of the settings that were told of last stand for, by their names."""


def know(config: Config) -> None:
    """Learn what a run's sections call its methods: a user's own, and those that stand twice."""
    for scene in config.scenes:
        for name, section in config.methods_of(scene).items():
            _OF_SECTION[name] = section.method or name


def _told(method: str, name: str, default: str) -> str:
    """Return what a method says of itself; a default where it isn't to be found."""
    try:
        told: str | None = getattr(
            plugins.find(plugins.METHODS, _OF_SECTION.get(method, method)), name
        )
    except InputError:
        return default
    return default if told is None else told


def title(method: str) -> str:
    """Return a method's name in words, with its section's where that is another."""
    told = _told(method, "title", words(method))
    is_own = _told(method, "name", method) == method
    return told if is_own else f"{told} ({words(method)})"


def colour(method: str) -> str:
    """Return a method's colour in plots."""
    return _told(method, "colour", _GREY)


def style(method: str) -> dict[str, Any]:
    """Return matplotlib's colour, marker and kind of line of a method's curve."""
    marker, line = _told(method, "marker", "o"), _told(method, "line", "-")
    return {"color": colour(method), "marker": marker, "linestyle": line}


def swatches(methods: Iterable[str]) -> dict[str, str]:
    """Return the colours of methods by their names in words."""
    return {title(method): colour(method) for method in methods}


def listed(methods: Iterable[str]) -> str:
    """Return the names of methods as part of a sentence."""
    *first, last = [title(method)[0].lower() + title(method)[1:] for method in methods]
    return f"{', '.join(first)} and {last}" if first else last
