"""Protocol of the storage of an acquisition, and the names of its contents.

Each stage of a level writes arrays or frames, its *store*, and a *manifest*: plain data about them,
written last. Some stages write further stores, *parts*, which their manifest describes by a key.

A store's *digest* is the hash of its content, and reveals damage. Its *fingerprint* is the hash of
all that its content is computed from: digests of other stores, settings, and the code. A store
whose fingerprint differs from the current one is made again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rfpipe.rigs import Rig
from rfpipe.units import VERIFICATION_KEY

Arrays = Mapping[str, NDArray[Any]]
Facts = dict[str, Any]

STAGES = ("schedule", "capture", "merge", "normalize", "refine")
"""Stages of a level, in their order."""

REFERENCE_BRACKETS = "reference_brackets"
"""Store and manifest key of the all-off and all-on brackets, captured with level 0."""

REFERENCE_IMAGES = "reference_images"
"""Store and key in level 0's merge manifest of black level, defects and floodlit image."""

SYMMETRY = "symmetry"
"""Store of the random patterns' brackets, captured with level 0; key of the symmetry test."""

CHECK_PICTURES = "check_pictures"
"""Store and manifest key of a level's check pictures, see `rfpipe.references.check_pictures`."""

SENSOR = "sensor"
"""Store and manifest key of a resampled sensor's arrays, beside the frames of level 0."""

SUMS = "sums"
"""Store and manifest key of the sum of a level's images and of their variance."""

LAMP = "lamp"
"""Key in level 0's merge manifest: brightness of the lamp before the first check picture."""

VERIFICATION = VERIFICATION_KEY
"""Number that stands for a level: the pictures that verify the transport."""

VERIFICATION_FOLDER = "verification"
"""Folder of the verification pictures, beside those of the levels."""

VERIFICATION_MANIFEST = "verification.json"
"""Result of a verification, beside the transport."""

WhenChanged = Literal["recapture", "refuse"]


class StoredPictures(Protocol):
    """Brackets or merged images of a level, one item per pattern.

    See `rfpipe.store.PictureStore`.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: Facts

    @property
    def done(self) -> NDArray[np.bool_]:
        """Mask of the items that are written, bool (items,)."""

    def missing(self, longest: int | None = None) -> list[tuple[int, int]]:
        """List the runs ``(first, last + 1)`` of items to be written, of at most `longest`."""

    def write(self, start: int, block: NDArray[Any]) -> None:
        """Write items from `start` on."""

    def enter(self, start: int, digests: list[str]) -> None:
        """Record items that an `ItemWriter` wrote."""

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Read items ``start:stop``."""

    def entry(self) -> Facts:
        """Describe complete frames for a manifest: digest, dtype and shape."""


class Storage(Protocol):
    """Storage of one acquisition."""

    def exists(self, level: int, stage: str) -> bool:
        """Test whether a stage of a level is complete."""

    def read_manifest(self, level: int, stage: str) -> Facts:
        """Read the manifest of a stage of a level."""

    def current_manifest(self, level: int, stage: str, fingerprint: str) -> Facts | None:
        """Return the manifest of a stage if its store has a fingerprint, else None.

        The manifest of another fingerprint is removed.
        """

    def write(
        self,
        level: int,
        stage: str,
        fingerprint: str,
        arrays: Arrays,
        facts: Facts,
        **attributes: Any,
    ) -> None:
        """Write a stage's arrays and its manifest of `facts`; `attributes` are for the store."""

    def write_part(self, level: int, part: str, arrays: Arrays, **attributes: Any) -> Facts:
        """Write arrays without a manifest; return their entry for one."""

    def write_manifest(self, level: int, stage: str, facts: Facts) -> None:
        """Write a manifest alone."""

    def read(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Facts]:
        """Read the arrays of a stage, or of a part, and the store's attributes."""

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Facts]:
        """Return the same as `read`, with arrays that are read when first used."""

    def pictures(
        self, level: int, stage: str, part: str | None = None
    ) -> AbstractContextManager[StoredPictures]:
        """Open the complete frames of a stage, or of a part."""

    def partial_brackets(self, level: int, part: str) -> AbstractContextManager[StoredPictures]:
        """Open frames that may be incomplete; StoreError if there are none."""

    def missing_brackets(
        self, level: int, part: str, count: int, longest: int
    ) -> list[tuple[int, int]]:
        """List the runs of the `count` frames that aren't captured, of at most `longest`."""

    def make_room(
        self, level: int, part: str, fingerprint: str, settings: Facts, when_changed: WhenChanged
    ) -> None:
        """Set aside frames of other settings, before frames of these settings are captured."""

    def record_brackets(
        self,
        level: int,
        part: str,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        fingerprint: str,
        settings: Facts,
    ) -> AbstractContextManager[StoredPictures]:
        """Open brackets for writing; made if there are none."""

    def record_images(
        self, level: int, shape: tuple[int, ...], fingerprint: str, layout: tuple[int, int]
    ) -> AbstractContextManager[tuple[StoredPictures, Any]]:
        """Open a level's merged images for writing, and a writer for any thread or process.

        `layout` is the number of patterns per chunk, and of chunks per file.
        """

    def folder(self, level: int) -> Path:
        """Folder of a level, which workers of a cluster must be able to read."""

    def images_without_raw(self, level: int, inputs: Facts, fingerprint: str) -> Facts | None:
        """Return the manifest of merged images whose brackets were dropped; None with brackets."""

    def drop_raw(self, level: int) -> None:
        """Remove the brackets of a level that is merged."""

    def describe_rig(self, rig: Rig) -> Facts:
        """Describe a rig for manifests and fingerprints."""

    def check_space(self, level: int, needed: int) -> None:
        """Raise StoreError if a capture of `needed` bytes doesn't fit."""

    def seconds_since_capture(self) -> float:
        """Seconds since the last bracket was captured; infinite if there is none."""

    def recovery_advice(self, level: int) -> str:
        """Describe how to go on after a capture that ended since the rig or its light changed."""

    def timing(self, level: int, stage: str) -> AbstractContextManager[None]:
        """Record the seconds that a stage takes."""

    def levels(self) -> Iterator[int]:
        """Yield the levels that are scheduled and have patterns, from level 0 on."""


def folder_name(level: int) -> str:
    """Name of a level's folder."""
    return VERIFICATION_FOLDER if level == VERIFICATION else f"L{level:02d}"


def level_name(level: int) -> str:
    """Name of a level in messages."""
    return "verification" if level == VERIFICATION else f"level {level}"


def rig_settings(rig: Rig) -> Facts:
    """Describe a rig without its speed, which shapes no frame."""
    return {name: value for name, value in rig.describe().items() if name != "seconds_per_pattern"}
