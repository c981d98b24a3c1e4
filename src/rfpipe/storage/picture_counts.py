"""Pictures that an acquisition takes on the rig, counted by their purpose.

A *picture* is one bracket, whatever for; the time on the rig is their number times
``capture.seconds_per_pattern``. *Patterns* are those of the method alone, as the thesis counts
them. The counts come from the manifests of the captures, so that every table has the same numbers.
Pictures that were taken again are counted once.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import inf
from typing import Any

from rfpipe.storage.base import (
    CHECK_PICTURES,
    MORE_REFERENCE_BRACKETS,
    REFERENCE_BRACKETS,
    SYMMETRY,
    VERIFICATION,
    ResultStorage,
)

_PURPOSES = {
    REFERENCE_BRACKETS: "references",
    MORE_REFERENCE_BRACKETS: "references",
    SYMMETRY: "symmetry",
    CHECK_PICTURES: "checks",
}
"""Purpose of the pictures of each part of a capture's manifest, beside the level's patterns."""


@dataclass(frozen=True)
class PictureCounts:
    """Numbers of pictures on the rig, by purpose.

    Attributes
    ----------
    references : int
        All-off and all-on brackets.
    symmetry : int
        Random patterns that measure whether the rig is coaxial.
    patterns : int
        Patterns of all levels of the method.
    checks : int
        Check pictures between them.
    verification : int
        Pictures that verify the transport.
    frames : int
        Exposures of all these pictures together.
    """

    references: int = 0
    symmetry: int = 0
    patterns: int = 0
    checks: int = 0
    verification: int = 0
    frames: int = 0

    @property
    def total(self) -> int:
        """Number of pictures for all purposes."""
        return sum(self.by_purpose().values())

    def by_purpose(self) -> dict[str, int]:
        """Return the number of pictures of each purpose, as plain data."""
        numbers = asdict(self)
        del numbers["frames"]
        return numbers

    def __add__(self, other: PictureCounts) -> PictureCounts:
        """Add up the pictures of each purpose, and the frames."""
        numbers = asdict(other)
        return PictureCounts(**{name: n + numbers[name] for name, n in asdict(self).items()})


def captured_pictures(storage: ResultStorage, last_level: float = inf) -> PictureCounts:
    """Count the pictures of an acquisition up to a level, and those of its verification.

    The verification is counted for any last level: a transport that ends earlier needs it too.
    Without captures the counts are 0.

    Raises
    ------
    IntegrityError
        If the manifest of a capture is damaged.
    """
    counts = pictures_of_levels(storage, last_level)
    if storage.exists(VERIFICATION, "capture"):
        counts += _counts_of(VERIFICATION, storage)
    return counts


def pictures_of_levels(storage: ResultStorage, last_level: float = inf) -> PictureCounts:
    """Count the pictures of an acquisition up to a level, without those of its verification."""
    counts, level = PictureCounts(), 0
    while level <= last_level and storage.exists(level, "capture"):
        counts += _counts_of(level, storage)
        level += 1
    return counts


def _counts_of(level: int, storage: ResultStorage) -> PictureCounts:
    """Count the pictures of a level, or of the verification."""
    manifest = storage.read_manifest(level, "capture")
    parts = {key: manifest[key] for key in _PURPOSES if manifest.get(key)}
    frames = sum(_frame_count(entry) for entry in (manifest, *parts.values()))
    purpose = "verification" if level == VERIFICATION else "patterns"
    counts = PictureCounts(**{purpose: int(manifest["patterns"])}, frames=frames)
    for key, entry in parts.items():
        counts += PictureCounts(**{_PURPOSES[key]: int(entry["shape"][0])})
    return counts


def _frame_count(entry: dict[str, Any]) -> int:
    """Count the exposures of a store of brackets, of shape (brackets, exposures, ...)."""
    n_brackets, n_exposures = entry["shape"][:2]
    return int(n_brackets * n_exposures)
