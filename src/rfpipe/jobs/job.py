"""What every job of the workflow has: its log, a bar of progress, an end when it is stopped."""

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

_SECONDS_BETWEEN_LINES = 15.0  # of progress, where there is no terminal

_log = logging.getLogger("rfpipe")


def start(log_file: str) -> None:
    """Log to a file and to stderr; say why the job ends when it ends early; bound its threads.

    An `RfpipeError` is reported by its message, with the traceback in the file alone. SIGTERM
    interrupts like Ctrl-C, so that stores are closed before the process ends.

    Parameters
    ----------
    log_file : str
        Replaced when it exists.
    """
    # Snakemake tells a job how many threads it has; numba doesn't listen by itself.
    os.environ.setdefault("NUMBA_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    path = Path(log_file)
    path.parent.mkdir(parents=True, exist_ok=True)
    to_file = logging.FileHandler(path, mode="w")
    to_file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    to_terminal = logging.StreamHandler()
    to_terminal.setFormatter(_Brief(path))
    logging.raiseExceptions = False  # a log on a full disk is done without: the stage says that
    _log.setLevel(logging.INFO)
    _log.handlers = [to_file, to_terminal]
    _log.propagate = False
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(to_file)
    sys.excepthook = _report
    signal.signal(signal.SIGTERM, _interrupt)


class _Brief(logging.Formatter):
    """The message alone, after the name of the job; tracebacks are for the file."""

    def __init__(self, log_file: Path) -> None:
        super().__init__(f"{'/'.join(log_file.with_suffix('').parts[-4:])}: %(message)s")

    def format(self, record: logging.LogRecord) -> str:
        brief = logging.makeLogRecord({**record.__dict__, "exc_info": None, "exc_text": None})
        return super().format(brief)


def _report(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        _log.error("stopped; what is done is kept, and the next run goes on from there")
        return
    message = str(error)
    if not issubclass(kind, RfpipeError):  # a bug: show where
        sys.__excepthook__(kind, error, traceback)
        message = f"{type(error).__name__}: {error}"
    _log.error("%s", message, exc_info=(kind, error, traceback))


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class _LoggedCount:
    """Progress as lines of the log, at most one in each `_SECONDS_BETWEEN_LINES`.

    Lines are plain text: a bar moves the cursor by codes that only a terminal understands.
    """

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
        """Do nothing: the stage logs its end."""

    def _line(self, elapsed: float) -> str:
        """Describe the progress; the time to go needs a total and something to measure it by."""
        if not 0 < self._total >= self._done:
            return counted(self._done, self._unit)
        line = f"{self._done} of {counted(self._total, self._unit)}"
        if self._done == self._first:
            return line
        seconds = elapsed * (self._total - self._done) / (self._done - self._first)
        minutes, seconds = divmod(round(seconds), 60)
        hours, minutes = divmod(minutes, 60)
        to_go = f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes:02d}:{seconds:02d}"
        return f"{line}, {to_go} to go"


class Progress:
    """Counts patterns or steps, and says when the rest will be done; a context manager.

    Parameters
    ----------
    name : str
        What is in progress.
    total, done : int
        In all, 0 where that is unknown, and those done before.
    shown : bool
    unit : str
        What is counted, one of them.
    """

    def __init__(
        self, name: str, total: int, done: int = 0, *, shown: bool = True, unit: str = "pattern"
    ) -> None:
        self._bar: Any = None
        if shown and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=total or None, initial=done, desc=name, unit=unit, leave=False)
        elif shown:
            self._bar = _LoggedCount(name, total, done, unit)

    def advance(self, count: int) -> None:
        """Count so many as done."""
        if self._bar is not None:
            self._bar.update(count)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
