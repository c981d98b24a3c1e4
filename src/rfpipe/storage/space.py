"""Check of the free disk space before a capture."""

from __future__ import annotations

import logging
from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.store import files

_log = logging.getLogger(__name__)


def check_space(name: str, needed: int, folder: Path, present: int = 0) -> None:
    """Check that a capture fits on the disk.

    Parameters
    ----------
    name : str
        Name of the capture, for messages.
    needed : int
        Upper limit of its size in bytes.
    folder : Path
        Folder of the acquisition.
    present : int
        Bytes of files in the folder that the capture replaces.

    Raises
    ------
    StoreError
        If less is free on the folder's file system.
    """
    free = files.free_bytes(folder)
    if needed - present > free:
        raise StoreError(
            f"{folder}: the capture of {name} isn't begun: it and its results take up to "
            f"{bytes_text(needed)}, of which {bytes_text(present)} are used already; "
            f"{bytes_text(free)} are free on this file system",
            remedy="Make room, put the results on another disk, set capture.keep_raw to false, or "
            "choose the method's options for fewer patterns; then run again: captured pictures are "
            "kept",
        )
    _log.info("%s: takes up to %s; %s are free", name, bytes_text(needed), bytes_text(free))


def bytes_text(count: int) -> str:
    """Return a number of bytes with three digits, such as ``629 MB``."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e6:.3g} MB"
