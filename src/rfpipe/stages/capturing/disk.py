"""Disk space: what a capture, and all that is made of it, will take at most."""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Protocol

import numpy as np

from rfpipe.errors import StoreError
from rfpipe.photometry import Sensor
from rfpipe.units import RADIANCE

__all__ = [
    "DiskNeed",
    "Imaging",
    "check_level",
    "check_run",
    "free_bytes",
    "size_text",
]

# A file takes whole blocks of its file system.
_BLOCK_BYTES = 4096
# What the methods keep of a level: each pixel of each image belongs to one piece that they may
# store, in the level's own store and in the transport.
_PIECES = 2
_log = logging.getLogger(__name__)


class Imaging(Protocol):
    """A rig, as far as the size of its pictures goes."""

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """As that of `rfpipe.rigs.Rig`."""

    @property
    def channels(self) -> int:
        """As that of `rfpipe.rigs.Rig`."""

    @property
    def sensor(self) -> Sensor:
        """As that of `rfpipe.rigs.Rig`."""


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
    def of(cls, rig: Imaging, to_capture: int, patterns: int) -> DiskNeed:
        """Return that of some brackets still to be captured, and of patterns to be merged."""
        bracket = prod(rig.sensor.frame_shape(rig.camera_shape, rig.channels))
        image = prod(rig.camera_shape) * rig.channels
        radiance = np.dtype(RADIANCE).itemsize
        sums = 2 * np.dtype(np.float64).itemsize
        return cls(
            raw=to_capture * (bracket * rig.sensor.frame_dtype.itemsize + _BLOCK_BYTES),
            merged=patterns * (2 * image * radiance + _BLOCK_BYTES),
            rest=image * (_PIECES * patterns * radiance + sums),
        )

    @property
    def total(self) -> int:
        """Sum of all."""
        return self.raw + self.merged + self.rest

    def __str__(self) -> str:
        return (
            f"{size_text(self.total)} (raw exposures {size_text(self.raw)}, merged images "
            f"{size_text(self.merged)}, the rest {size_text(self.rest)})"
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
            f"{need}, of which {size_text(present)} are there already; {size_text(free)} are "
            f"free on this file system. {_advice(keep_raw)}, or choose the method's options for "
            "fewer patterns; then run again: what is captured is kept"
        )
    _log.info("%s: takes up to %s; %s are free", name, need, size_text(free))


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
            folder, need, size_text(free), _advice(keep_raw),
        )  # fmt: skip


def free_bytes(folder: Path) -> int:
    """Return the bytes free on the file system of a folder, which needn't exist yet."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free


def _advice(keep_raw: bool) -> str:
    drop = ", set capture.keep_raw to false" if keep_raw else ""
    return f"Make room, put the results on another disk{drop}"


def size_text(count: int) -> str:
    """Return a number of bytes as text."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e6:.3g} MB"
