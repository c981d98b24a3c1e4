"""What every job of the workflow has: its log, a bar of progress, an end when it is stopped."""

from __future__ import annotations

import logging
import os
import signal
import sys
from io import StringIO
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from rfpipe.errors import RfpipeError

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


class _LogLines(StringIO):
    """Writes the bar's lines into the log."""

    def write(self, text: str) -> int:
        if text.strip():
            _log.info("%s", text.strip())
        return len(text)


class Progress:
    """Counts patterns or steps, and says when the rest will be done; a context manager.

    Parameters
    ----------
    name : str
        What is in progress.
    total, done : int
        In all, and those done before.
    shown : bool
    unit : str
        What is counted, one of them.
    """

    def __init__(
        self, name: str, total: int, done: int = 0, *, shown: bool = True, unit: str = "pattern"
    ) -> None:
        from tqdm import tqdm

        to_log: dict[str, Any] = {
            "file": _LogLines(), "mininterval": _SECONDS_BETWEEN_LINES, "miniters": 1,
            "delay": _SECONDS_BETWEEN_LINES,
            "bar_format": "{desc}: {n_fmt} of {total_fmt} {unit}s, {remaining} to go",
        }  # fmt: skip
        self._bar: Any = tqdm(
            total=total, initial=done, desc=name, unit=unit, leave=False, disable=not shown,
            **({} if sys.stderr.isatty() else to_log),
        )  # fmt: skip

    def advance(self, count: int) -> None:
        """Count so many as done."""
        self._bar.update(count)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
