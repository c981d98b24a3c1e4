"""Tell somebody that a run has ended: a night-long one ends when nobody is looking."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from typing import Literal

__all__ = ["notify"]

_PATIENCE_SECONDS = 60


def notify(command: str | None, status: Literal["done", "failed"], log: str) -> bool:
    """Run the user's command; whatever it does, the run has ended as it has.

    Parameters
    ----------
    command : str or None
        A program and its arguments, quoted as for a shell, which isn't used. It finds
        ``RFPIPE_STATUS`` and ``RFPIPE_LOG`` in its environment and has a minute. None does nothing.
    status : {"done", "failed"}
    log : str
        Snakemake's log file.

    Returns
    -------
    bool
        Whether somebody was told.
    """
    if command is None:
        return False
    environment = {**os.environ, "RFPIPE_STATUS": status, "RFPIPE_LOG": log}
    try:
        subprocess.run(shlex.split(command), env=environment, timeout=_PATIENCE_SECONDS, check=True)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        print(f"rfpipe: notify: {command!r} failed: {error}", file=sys.stderr)
        return False
    return True
