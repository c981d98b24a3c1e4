"""Disk space: what a capture, and all that is made of it, will take at most."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from rfpipe.errors import StoreError
from rfpipe.photometry import Sensor
from rfpipe.store.files import free_bytes
from rfpipe.units import RADIANCE

__all__ = [
    "DiskNeed",
    "check_level",
    "check_run",
    "shown_bytes",
]

# A file takes whole blocks of its file system.
_BLOCK_BYTES = 4096
# What the methods keep of a level: each pixel of each image belongs to one piece that they may
# store, in the level's own store and in the transport.
_PIECES = 2
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DiskNeed:
    """Bytes on the disk, before compression.

    Parameters
    ----------
    raw : int
        Of the brackets.
    merged : int
        Of radiance and variance.
    rest : int
        Of sums and factors, and of what the method keeps.
    """

    raw: int
    merged: int
    rest: int

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        camera_shape: tuple[int, ...],
        channels: int,
        to_capture: int,
        patterns: int,
    ) -> DiskNeed:
        """Return that of some brackets still to be captured, and of patterns to be merged."""
        bracket = prod(sensor.frame_shape(camera_shape, channels))
        image = prod(camera_shape) * channels
        radiance = np.dtype(RADIANCE).itemsize
        sums = 2 * np.dtype(np.float64).itemsize
        return cls(
            raw=to_capture * (bracket * sensor.frame_dtype.itemsize + _BLOCK_BYTES),
            merged=patterns * (2 * image * radiance + _BLOCK_BYTES),
            rest=image * (_PIECES * patterns * radiance + sums),
        )

    @property
    def total(self) -> int:
        """Sum of all."""
        return self.raw + self.merged + self.rest

    def __str__(self) -> str:
        return (
            f"{shown_bytes(self.total)} (raw exposures {shown_bytes(self.raw)}, merged images "
            f"{shown_bytes(self.merged)}, the rest {shown_bytes(self.rest)})"
        )


def check_level(
    name: str, need: DiskNeed, folder: Path, present: int = 0, *, keep_raw: bool = True
) -> None:
    """Log what a level will take at most, and refuse its capture where that doesn't fit.

    Parameters
    ----------
    name : str
    need : DiskNeed
    folder : Path
        Where it is to lie.
    present : int
        Bytes there already that will be written over.
    keep_raw : bool
        Whether the brackets of all levels stay.

    Raises
    ------
    StoreError
        When less is free on the folder's file system.
    """
    free = free_bytes(folder)
    if need.total - present > free:
        raise StoreError(
            f"{folder}: the capture of {name} isn't begun: it and what is made of it take up to "
            f"{need}, of which {shown_bytes(present)} are there already; {shown_bytes(free)} are "
            f"free on this file system. {_advice(keep_raw)}, or choose the method's options for "
            "fewer patterns; then run again: what is captured is kept"
        )
    _log.info("%s: takes up to %s; %s are free", name, need, shown_bytes(free))


def check_run(need: DiskNeed, patterns: int, folder: Path, *, keep_raw: bool = True) -> None:
    """Log what a whole acquisition will take; warn where that isn't likely to fit.

    It is no error: how many patterns it takes is a guess, and each level is checked again before
    its capture.
    """
    free = free_bytes(folder)
    _log.info("all levels: about %d patterns take up to %s", patterns, need)
    if need.total > free:
        _log.warning(
            "%s: all levels may take up to %s, but %s are free. The run will stop before the "
            "level that doesn't fit. %s",
            folder, need, shown_bytes(free), _advice(keep_raw),
        )  # fmt: skip


def _advice(keep_raw: bool) -> str:
    drop = ", set capture.keep_raw to false" if keep_raw else ""
    return f"Make room, put the results on another disk{drop}"


def shown_bytes(count: int) -> str:
    """Show a number of bytes to three digits, such as ``629 MB``."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e6:.3g} MB"
