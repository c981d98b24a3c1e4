"""Protocols of the storage of an acquisition, the names of its contents, and a glossary.

Pictures:

- *frame*: one exposure of a camera, in raw counts.
- *bracket*: the frames of one pattern, one per exposure time, (E, ...). The setting ``keep_raw``
  means brackets.
- *image*: an array over the camera's rays, such as the radiance merged from a bracket, with its
  variance.
- *picture*: what a camera takes of one pattern, as a bracket or as the image merged from it.
- *item*: one picture in a store, which has one item per pattern.

Results:

- *store*: arrays or pictures that a stage of a level writes, with attributes. A *part* is a further
  store of a stage, such as the sum of a level's images.
- *manifest*: plain data about the result of a stage, written last: a stage with a manifest is
  complete. It consists of the stage's facts, the entry of its store, an entry per part under the
  name of the part, the fingerprint, and the versions of rfpipe and its libraries. The
  manifest of a schedule has only facts, so that equal patterns have equal manifests.
- *facts*: plain data by which a stage describes its result, such as units or number of patterns.
- *entry*: plain data by which a manifest describes a store: its digest, and the shape and dtype of
  pictures.
- *attributes*: plain data inside a store. They may include the stage's facts, from which a lost
  manifest of merged images is restored.
- *digest*: hash of the content of a store, a file or patterns, which reveals damage and changes.
- *fingerprint*: hash of all that a result is computed from: digests of other stores, settings, and,
  except for captures, the code. A result whose fingerprint differs from the current one is computed
  again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from itertools import count
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rfpipe.errors import IntegrityError
from rfpipe.rigs import Rig
from rfpipe.units import VERIFICATION_KEY

Arrays = Mapping[str, NDArray[Any]]
Facts = dict[str, Any]
Manifest = dict[str, Any]
Entry = dict[str, Any]
Attributes = dict[str, Any]

STAGES = ("schedule", "capture", "merge", "normalize", "refine")
"""Stages of a level, in their order."""

REFERENCE_BRACKETS = "reference_brackets"
"""Store and manifest key of the all-off and all-on brackets, captured with level 0."""

MORE_REFERENCE_BRACKETS = "more_reference_brackets"
"""Store and manifest key of further such brackets, whose number follows from the first ones."""

REFERENCE_GOAL = "reference_goal"
"""Key in level 0's capture manifest: target from which the number of further brackets follows."""

REFERENCE_IMAGES = "reference_images"
"""Store and key in level 0's merge manifest of black level, defects and floodlit image."""

SYMMETRY = "symmetry"
"""Store of the random patterns' brackets, captured with level 0; key of the symmetry test."""

CHECK_PICTURES = "check_pictures"
"""Store and manifest key of a level's check pictures, see `rfpipe.references.check_pictures`."""

SENSOR = "sensor"
"""Store and manifest key of a resampled sensor's arrays, beside the brackets of level 0."""

SUMS = "sums"
"""Store and manifest key of the sum of a level's images and of their variance."""

LAMP = "lamp"
"""Key in level 0's merge manifest: brightness of the lamp before the first check picture."""

VERIFICATION = VERIFICATION_KEY
"""Level number of the pictures that verify the transport."""

VERIFICATION_FOLDER = "verification"
"""Folder of the verification pictures, beside those of the levels."""

VERIFICATION_MANIFEST = "verification.json"
"""Result of a verification, beside the transport."""

WhenChanged = Literal["recapture", "refuse"]
"""Reaction to brackets of other settings: set them aside and capture again, or raise an error."""


class StoredPictures(Protocol):
    """Pictures of a level, brackets or images; see `rfpipe.store.PictureStore`.

    There is one item per pattern; the shape is (items, *shape of an item).
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: Attributes

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

    def entry(self) -> Entry:
        """Describe complete pictures for a manifest: digest, dtype and shape."""


class ResultStorage(Protocol):
    """Manifests and arrays of the stages of an acquisition."""

    def exists(self, level: int, stage: str) -> bool:
        """Test whether a stage of a level is complete."""

    def read_manifest(self, level: int, stage: str) -> Manifest:
        """Read the manifest of a stage of a level."""

    def current_manifest(self, level: int, stage: str, fingerprint: str) -> Manifest | None:
        """Return the manifest of a stage if its store has a fingerprint, else None.

        The manifest of another fingerprint is removed.
        """

    def write_manifest(self, level: int, stage: str, manifest: Manifest) -> None:
        """Write a manifest alone."""

    def read(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Attributes]:
        """Read the arrays of a stage, or of a part, and the store's attributes."""

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Attributes]:
        """Return the same as `read`, with arrays that are read when first used."""

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

    def write_part(self, level: int, part: str, arrays: Arrays, **attributes: Any) -> Entry:
        """Write the arrays of a part; return its entry for the stage's manifest."""


class PictureStorage(Protocol):
    """Brackets and merged images of an acquisition."""

    def pictures(
        self, level: int, stage: str, part: str | None = None
    ) -> AbstractContextManager[StoredPictures]:
        """Open the complete pictures of a stage, or of a part."""

    def partial_brackets(self, level: int, part: str) -> AbstractContextManager[StoredPictures]:
        """Open brackets that may be incomplete; StoreError if there are none."""

    def missing_brackets(
        self, level: int, part: str, count: int, longest: int
    ) -> list[tuple[int, int]]:
        """List the runs of the `count` brackets that aren't captured, of at most `longest`."""

    def make_room(
        self,
        level: int,
        part: str,
        fingerprint: str,
        attributes: Attributes,
        when_changed: WhenChanged,
    ) -> None:
        """Set aside brackets of other settings, before brackets are captured."""

    def record_brackets(
        self,
        level: int,
        part: str,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        fingerprint: str,
        attributes: Attributes,
    ) -> AbstractContextManager[StoredPictures]:
        """Open a store of brackets for writing; create it if there is none."""

    def record_images(
        self, level: int, shape: tuple[int, ...], fingerprint: str, layout: tuple[int, int]
    ) -> AbstractContextManager[tuple[StoredPictures, Any]]:
        """Open a level's merged images for writing, and a writer for any thread or process.

        `layout` is the number of patterns per chunk, and of chunks per file.
        """

    def images_without_raw(self, level: int, inputs: Facts, fingerprint: str) -> Manifest | None:
        """Return the manifest of merged images whose brackets were dropped; None with brackets."""

    def drop_raw(self, level: int) -> None:
        """Remove the brackets of a level that is merged."""


class CaptureServices(Protocol):
    """Description of the rig, disk space, times, and advice to users, where the results are."""

    def folder(self, level: int) -> Path:
        """Folder of a level, which workers of a cluster must be able to read."""

    def describe_rig(self, rig: Rig) -> Facts:
        """Describe a rig for manifests and fingerprints."""

    def check_space(self, level: int, needed: int) -> None:
        """Raise StoreError if a capture of `needed` bytes doesn't fit."""

    def timing(self, level: int, stage: str) -> AbstractContextManager[None]:
        """Record the seconds that a stage takes."""

    def seconds_since_capture(self) -> float:
        """Seconds since the last bracket was captured; infinite if there is none."""

    def recovery_advice(self, level: int) -> str:
        """Describe how to go on after a capture that ended since the rig or its light changed."""


class Storage(ResultStorage, PictureStorage, CaptureServices, Protocol):
    """Storage of one acquisition, in files (`FolderStorage`) or in memory (`MemoryStorage`)."""


def scheduled_levels(storage: ResultStorage) -> Iterator[int]:
    """Yield the levels that are scheduled and have patterns, from level 0 on.

    They end before a damaged schedule, which is about to be written again.
    """
    for level in count():
        try:
            is_shown = (
                storage.exists(level, "schedule")
                and storage.read_manifest(level, "schedule")["patterns"]
            )
        except IntegrityError:
            return
        if not is_shown:
            return
        yield level


def folder_name(level: int) -> str:
    """Name of a level's folder."""
    return VERIFICATION_FOLDER if level == VERIFICATION else f"L{level:02d}"


def level_name(level: int) -> str:
    """Name of a level in messages."""
    return "verification" if level == VERIFICATION else f"level {level}"


def rig_settings(rig: Rig) -> Facts:
    """Describe a rig without its speed, which has no effect on frames."""
    return {name: value for name, value in rig.describe().items() if name != "seconds_per_pattern"}
