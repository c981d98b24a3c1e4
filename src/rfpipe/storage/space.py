"""Space on the disk that captures take, checked before any pattern is displayed."""

from __future__ import annotations

import logging
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store import files

_log = logging.getLogger(__name__)


def check_space(name: str, needed: int, folder: Path, present: int = 0) -> None:
    """Refuse a capture that doesn't fit on the disk, before anything is shown.

    `needed` bytes are taken at most, of which those `present` in the folder are replaced. Raises
    StoreError when less is free on the folder's file system.
    """
    free = files.free_bytes(folder)
    if needed - present > free:
        raise StoreError(
            f"{folder}: the capture of {name} isn't begun: it and what is made of it take up to "
            f"{bytes_text(needed)}, of which {bytes_text(present)} are there already; "
            f"{bytes_text(free)} are free on this file system. Make room, put the results on "
            "another disk, set capture.keep_raw to false, or choose the method's options for "
            "fewer patterns; then run again: what is captured is kept"
        )
    _log.info("%s: takes up to %s; %s are free", name, bytes_text(needed), bytes_text(free))


def bytes_text(count: int) -> str:
    """Show a number of bytes to three digits, such as ``629 MB``."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e6:.3g} MB"
