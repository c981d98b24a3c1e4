"""Progress: a bar on a terminal, else a line now and then in the log; a method's own estimates."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping, Sequence
from time import monotonic
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["Progress", "log_estimate"]

_SECONDS_BETWEEN_LINES = 15.0

_log = logging.getLogger(__name__)


class Progress:
    """Says how many patterns are done, and when the rest will be; a context manager.

    Parameters
    ----------
    name : str
        What is in progress.
    total, done : int
        Patterns in all, and those done before.
    unit : str
        What is counted, if no patterns; its plural has an s.
    quick : bool
        Whether it is nothing to speak of where it takes seconds.
    """

    def __init__(
        self, name: str, total: int, done: int = 0, *, unit: str = "pattern", quick: bool = False
    ) -> None:
        self._name = name
        self._unit = unit
        self._quick = quick
        self._total = total
        self._before = self._done = done
        self._began = self._said = monotonic()
        self._bar: tqdm[Any] | None = None
        if done < total and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=total, initial=done, desc=name, unit=unit, leave=False)

    def advance(self, patterns: int) -> None:
        """Count so many as done."""
        self._done += patterns
        now = monotonic()
        if self._bar is not None:
            self._bar.update(patterns)
        elif now - self._said >= _SECONDS_BETWEEN_LINES and self._done < self._total:
            self._said = now
            rest = (now - self._began) / (self._done - self._before) * (self._total - self._done)
            _log.info(
                "%s: %d of %d %ss, %s to go",
                self._name, self._done, self._total, self._unit, _time(rest),
            )  # fmt: skip

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
        patterns, seconds = self._done - self._before, monotonic() - self._began
        if patterns and not (self._quick and seconds < _SECONDS_BETWEEN_LINES):
            _log.info("%s: %d %ss in %s", self._name, patterns, self._unit, _time(seconds))


def log_estimate(level_rows: Sequence[Mapping[str, Any]], options: object) -> None:
    """Log the error that a method estimated after the last of its levels, if it did.

    Parameters
    ----------
    level_rows : sequence of dict
        Of the levels so far, as `rfpipe.transport.Transport.level_rows`.
    options : Options
        The method's; its ``target_error``, where it has one, is the error asked for.
    """
    # the merge has progress, too, and nothing to do with transports
    from rfpipe.transport.history import estimates

    found = estimates(level_rows)
    if found and found[-1]["level"] == level_rows[-1]["level"]:
        last = found[-1]
        target_error = getattr(options, "target_error", None)
        _log.info(
            "level %d: estimated error %.2f %% after %d patterns%s",
            last["level"],
            100 * last["estimated_error"],
            last["patterns"],
            "" if target_error is None else f", {100 * target_error:.3g} % asked for",
        )


def _time(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02.0f} s" if minutes else f"{rest:.1f} s"
