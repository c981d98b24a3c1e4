"""Progress: a bar on a terminal, else a line now and then in the log."""

from __future__ import annotations

import logging
import sys
from io import StringIO
from time import monotonic
from typing import Any

_SECONDS_BETWEEN_LINES = 15.0

_log = logging.getLogger(__name__)


class _LogLines(StringIO):
    """Writes the bar's lines into the log."""

    def write(self, text: str) -> int:
        if text.strip():
            _log.info("%s", text.strip())
        return len(text)


class Progress:
    """Counts patterns, and says when the rest will be done; a context manager.

    Parameters
    ----------
    name : str
        What is in progress.
    total, done : int
        Patterns in all, and those done before.
    unit : str
        What is counted, if no patterns; its plural has an s.
    quick : bool
        Whether it goes unsaid that it ended where it took seconds.
    """

    def __init__(
        self, name: str, total: int, done: int = 0, *, unit: str = "pattern", quick: bool = False,
        shown: bool = True,
    ) -> None:  # fmt: skip
        from tqdm import tqdm

        to_log: dict[str, Any] = {
            "file": _LogLines(), "mininterval": _SECONDS_BETWEEN_LINES, "miniters": 1,
            "delay": _SECONDS_BETWEEN_LINES,
            "bar_format": "{desc}: {n_fmt} of {total_fmt} {unit}s, {remaining} to go",
        }  # fmt: skip
        self._name, self._unit, self._done = name, unit, done
        self._began = monotonic()
        self._least = _SECONDS_BETWEEN_LINES if quick else 0.0
        self._bar: Any = tqdm(
            total=total, initial=done, desc=name, unit=unit, leave=False, disable=not shown,
            **({} if sys.stderr.isatty() else to_log),
        )  # fmt: skip

    def advance(self, patterns: int) -> None:
        """Count so many as done."""
        self._bar.update(patterns)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
        count, seconds = self._bar.n - self._done, monotonic() - self._began
        if count > 0 and seconds >= self._least:
            took = self._bar.format_interval(seconds)
            _log.info("%s: %d %ss in %s", self._name, count, self._unit, took)
