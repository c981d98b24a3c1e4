"""Start of a job of the workflow with its log and signal handlers, and its progress."""

from __future__ import annotations

import logging
import os
import signal
import sys
from pathlib import Path
from time import monotonic
from types import FrameType, TracebackType
from typing import Any

from rfpipe.errors import RfpipeError
from rfpipe.text import counted

_SECONDS_BETWEEN_LINES = 15.0
"""Seconds between lines of progress in a log."""

_log = logging.getLogger("rfpipe")


def start(log_file: str) -> None:
    """Set up the log, the handlers of errors and signals, and the threads of a job.

    Messages are logged to a file and to stderr. An `RfpipeError` that ends the job is logged as
    its message, with the traceback in the file only. SIGTERM interrupts the job as Ctrl-C does, so
    that stores are closed before the process ends.

    Parameters
    ----------
    log_file : str
        Path of the log file; an existing file is replaced.
    """
    # Snakemake sets OMP_NUM_THREADS, which numba doesn't read.
    os.environ.setdefault("NUMBA_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    path = Path(log_file)
    path.parent.mkdir(parents=True, exist_ok=True)
    to_file = logging.FileHandler(path, mode="w")
    to_file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    to_terminal = logging.StreamHandler()
    to_terminal.setFormatter(_Brief(path))
    logging.raiseExceptions = False  # a full disk ends the stage with a message
    _log.setLevel(logging.INFO)
    _log.handlers = [to_file, to_terminal]
    _log.propagate = False
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(to_file)
    sys.excepthook = _report
    signal.signal(signal.SIGTERM, _interrupt)


class _Brief(logging.Formatter):
    """Format a message as the name of the job and the message, without a traceback."""

    def __init__(self, log_file: Path) -> None:
        super().__init__(f"{'/'.join(log_file.with_suffix('').parts[-4:])}: %(message)s")

    def format(self, record: logging.LogRecord) -> str:
        brief = logging.makeLogRecord({**record.__dict__, "exc_info": None, "exc_text": None})
        return super().format(brief)


def _report(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        _log.warning("stopped; finished work is kept, and the next run continues from there")
        return
    message = str(error)
    if not issubclass(kind, RfpipeError):  # a bug: show its traceback
        sys.__excepthook__(kind, error, traceback)
        message = f"{type(error).__name__}: {error}"
    _log.error("%s", message, exc_info=(kind, error, traceback))


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class _LoggedCount:
    """Progress as lines of the log, at most one every `_SECONDS_BETWEEN_LINES`."""

    def __init__(self, name: str, total: int, done: int, unit: str) -> None:
        self._name, self._total, self._unit = name, total, unit
        self._first = self._done = done
        self._begun = self._logged = monotonic()

    def update(self, count: int) -> None:
        """Count patterns or steps, and log a line when one is due."""
        self._done += count
        now = monotonic()
        if now >= self._logged + _SECONDS_BETWEEN_LINES:
            self._logged = now
            _log.info("%s: %s", self._name, self._line(now - self._begun))

    def close(self) -> None:
        """Do nothing: the stage logs the end of its work."""

    def _line(self, elapsed: float) -> str:
        """Describe the progress after `elapsed` seconds, with the remaining time if it is known."""
        if not 0 < self._total >= self._done:
            return counted(self._done, self._unit)
        line = f"{self._done} of {counted(self._total, self._unit)}"
        if self._done == self._first:
            return line
        seconds = elapsed * (self._total - self._done) / (self._done - self._first)
        minutes, seconds = divmod(round(seconds), 60)
        hours, minutes = divmod(minutes, 60)
        clock = f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes:02d}:{seconds:02d}"
        return f"{line}, {clock} to go"


class Progress:
    """Progress of a job: a bar on a terminal, else lines of the log; a context manager.

    Parameters
    ----------
    name : str
        Name of the work, such as "level 2".
    total : int
        Number of patterns or steps, 0 where it is unknown.
    done : int
        Number of those that were done before.
    is_visible : bool
        Whether progress is displayed or logged at all.
    unit : str
        Name of a pattern or step, in the singular.
    """

    def __init__(
        self,
        name: str,
        total: int,
        done: int = 0,
        *,
        is_visible: bool = True,
        unit: str = "pattern",
    ) -> None:
        self._bar: Any = None
        if is_visible and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=total or None, initial=done, desc=name, unit=unit, leave=False)
        elif is_visible:
            self._bar = _LoggedCount(name, total, done, unit)

    def advance(self, count: int) -> None:
        """Count further patterns or steps as done."""
        if self._bar is not None:
            self._bar.update(count)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
