"""What every job of the workflow begins with: its log, and a clean end when it is stopped."""

from __future__ import annotations

import logging
import os
import signal
import sys
from pathlib import Path
from types import FrameType, TracebackType

from rfpipe.errors import RfpipeError

__all__ = ["start"]

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
    to_terminal.setFormatter(_Brief("/".join(path.with_suffix("").parts[-4:])))
    _log.setLevel(logging.INFO)
    _log.handlers = [to_file, to_terminal]
    _log.propagate = False
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(to_file)
    sys.excepthook = _report
    signal.signal(signal.SIGTERM, _interrupt)


class _Brief(logging.Formatter):
    """The message alone, after the job's name; tracebacks are for the file."""

    def __init__(self, job: str) -> None:
        super().__init__(f"{job}: %(message)s")

    def format(self, record: logging.LogRecord) -> str:
        brief = logging.makeLogRecord({**record.__dict__, "exc_info": None, "exc_text": None})
        return super().format(brief)


def _report(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        _log.error("stopped; what is done is kept, and the next run goes on from there")
        return
    if not issubclass(kind, RfpipeError):  # a bug: show where
        sys.__excepthook__(kind, error, traceback)
    _log.error("%s", error, exc_info=(kind, error, traceback))


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
