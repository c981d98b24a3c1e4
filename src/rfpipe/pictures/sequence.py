"""Checks of files that form a sequence: doubled pictures, and numbers that leap."""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["check_sequence", "pixel_fingerprint"]

_NUMBER = re.compile(r"\d+")
_BLOCK = 2**20
_MOST_NAMES = 4


def check_sequence(
    files: Sequence[Path], *, ordered: bool = True, fingerprints: Sequence[Hashable] = ()
) -> list[str]:
    """Check the names and contents of pictures that are used in the order of their numbers.

    Parameters
    ----------
    files : sequence of Path
        Pictures in their order.
    ordered : bool
        Whether the order matters: False where another file names each picture's light.
    fingerprints : sequence of str, optional
        One `pixel_fingerprint` per file, to find pictures whose files differ in metadata alone.

    Returns
    -------
    list of str
        Notes: pictures that are stored twice, and gaps in the numbers.

    Raises
    ------
    InputError
        When two files differ in their suffixes alone, as IMG_1.tif and IMG_1.jpg, or, if
        `ordered`, when the camera's counter wrapped: 9998, 9999, 0001.
    """
    stems: dict[tuple[Path, str], Path] = {}
    for file in files:
        first = stems.setdefault((file.parent, file.stem.lower()), file)
        if first is not file:
            raise InputError(
                f"{file}: has the name of {first.name} with another suffix; expected one file a "
                "picture",
                remedy="Move one of them to another folder",
            )
    notes = [
        f"{', '.join(file.name for file in same[:_MOST_NAMES])}"
        f"{f' and {len(same) - _MOST_NAMES} more' if len(same) > _MOST_NAMES else ''}: are the "
        "same picture, stored more than once"
        for same in _duplicates(files, fingerprints)
    ]
    return notes + (_leaps(files) if ordered else [])


def pixel_fingerprint(pixels: NDArray[Any]) -> str:
    """Return a hash of an array's shape, type and values."""
    header = f"{pixels.shape} {pixels.dtype}".encode()
    return hashlib.blake2b(header + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def _duplicates(files: Sequence[Path], fingerprints: Sequence[Hashable]) -> list[list[Path]]:
    """Return groups of files with the same bytes or fingerprints; large files are sampled first."""
    if fingerprints:
        return _split(files, fingerprints)
    groups = [[file for file in files if file.is_file()]]
    for key in (_size, _sample, _digest):
        groups = [part for group in groups for part in _split(group, [*map(key, group)])]
    return groups


def _split(files: Sequence[Path], keys: Sequence[Hashable]) -> list[list[Path]]:
    """Return the groups of at least two files of one key."""
    groups = defaultdict[Hashable, list[Path]](list)
    for file, key in zip(files, keys, strict=True):
        groups[key].append(file)
    return [group for group in groups.values() if len(group) > 1]


def _size(file: Path) -> int:
    return file.stat().st_size


def _sample(file: Path) -> bytes:
    """Return a block from the middle of a file."""
    with file.open("rb") as opened:
        opened.seek(max(0, file.stat().st_size // 2 - _BLOCK // 2))
        return hashlib.blake2b(opened.read(_BLOCK)).digest()


def _digest(file: Path) -> bytes:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "blake2b").digest()


def _leaps(files: Sequence[Path]) -> list[str]:
    """Return notes on gaps in the only number that varies; InputError where a counter wrapped."""
    numbers = [_NUMBER.findall(file.stem) for file in files]
    skeletons = {_NUMBER.sub("#", file.stem.lower()) for file in files}
    if len(files) < 3 or len(skeletons) != 1:
        return []
    varying = [column for column in zip(*numbers, strict=True) if len(set(column)) > 1]
    if len(varying) != 1:
        return []
    values = np.array([int(number) for number in varying[0]])
    steps = np.diff(values)
    sizes, counts = np.unique(steps, return_counts=True)
    step = int(sizes[counts.argmax()])
    gaps = np.flatnonzero(steps > step)
    if step < 1 or 2 * counts.max() < len(steps) or not len(gaps):
        return []
    digits = len(varying[0][-1])
    widest = int(gaps[steps[gaps].argmax()])
    wraps = digits >= 3 and values[-1] == 10**digits - 1 and values[0] <= step
    if wraps and len(gaps) == 1:
        raise InputError(
            f"{files[widest + 1].parent}: holds {files[0].name} to {files[widest].name} and "
            f"{files[widest + 1].name} to {files[-1].name}: the camera's counter began again, and "
            "names don't sort in the order of taking",
            remedy="Rename the files of the second group",
        )
    first = int(gaps[0])
    more = f", and {len(gaps) - 1} more gaps" if len(gaps) > 1 else ""
    between = f"{files[first].name} and {files[first + 1].name}"
    return [f"no number between {between}{more}: pictures may be missing"]
