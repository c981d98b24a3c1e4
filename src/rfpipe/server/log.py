"""Logs as lines of JSON, for people and for programs that watch."""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime
from pathlib import Path

from rfpipe.errors import ConfigError

__all__ = ["start_log"]

_LOGGERS = ("rfpipe", "uvicorn.error")
_FIELDS = ("client", "ms", "bytes")


class _JsonLines(logging.Formatter):
    """One JSON object a record."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **{name: value for name in _FIELDS if (value := getattr(record, name, None))},
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line)


def start_log(file: Path | None = None) -> None:
    """Log to stderr, and to the end of a file where one is named.

    Raises
    ------
    ConfigError
        When the file can't be written.
    """
    handlers: list[logging.Handler] = [logging.StreamHandler()]
    if file is not None:
        try:
            handlers.append(logging.FileHandler(file, encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{file}: can't be written as a log file: {error}") from error
    for handler in handlers:
        handler.setFormatter(_JsonLines())
    for name in _LOGGERS:
        logger = logging.getLogger(name)
        logger.handlers = list(handlers)
        logger.setLevel(logging.INFO)
        logger.propagate = False
