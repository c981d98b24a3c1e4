"""Disk space of a capture and of all that is made of it, at most."""

from __future__ import annotations

import logging
from math import prod
from pathlib import Path

import numpy as np

from rfpipe.errors import StoreError
from rfpipe.photometry import Sensor
from rfpipe.store import files
from rfpipe.units import RADIANCE

_BLOCK_BYTES = 4096  # a file takes whole blocks of its file system

_log = logging.getLogger(__name__)


def disk_bytes(
    sensor: Sensor, camera_shape: tuple[int, ...], channels: int, brackets: int, patterns: int
) -> int:
    """Return the bytes, before compression, of brackets and of what is made of patterns."""
    bracket = prod(sensor.frame_shape(camera_shape, channels)) * sensor.frame_dtype.itemsize
    image = prod(camera_shape) * channels
    # Radiance and variance; and each pixel of each image may be a piece that the method keeps, in
    # the level's own store and in the transport.
    merged = 4 * image * np.dtype(RADIANCE).itemsize
    sums = 2 * image * np.dtype(np.float64).itemsize
    return brackets * (bracket + _BLOCK_BYTES) + patterns * (merged + _BLOCK_BYTES) + sums


def check_disk(name: str, need: int, folder: Path, present: int = 0) -> None:
    """Refuse a capture that doesn't fit on the disk, before anything is shown.

    Parameters
    ----------
    name : str
        Of the level.
    need, present : int
        Bytes that it takes at most, and those of them that stand in the folder and are replaced.

    Raises
    ------
    StoreError
        When less is free on the folder's file system.
    """
    free = files.free_bytes(folder)
    if need - present > free:
        raise StoreError(
            f"{folder}: the capture of {name} isn't begun: it and what is made of it take up to "
            f"{shown_bytes(need)}, of which {shown_bytes(present)} are there already; "
            f"{shown_bytes(free)} are free on this file system. Make room, put the results on "
            "another disk, set capture.keep_raw to false, or choose the method's options for "
            "fewer patterns; then run again: what is captured is kept"
        )
    _log.info("%s: takes up to %s; %s are free", name, shown_bytes(need), shown_bytes(free))


def shown_bytes(count: int) -> str:
    """Show a number of bytes to three digits, such as ``629 MB``."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e6:.3g} MB"
