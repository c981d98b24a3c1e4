"""Check pictures: repeated pictures of one random pattern, taken between the patterns of a level.

A difference between a check picture and the first one shows that the rig or its light changed. They
are compared by `rfpipe.references.comparison`.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import StoreError
from rfpipe.photometry.sensor import MergedImages
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.storage.base import CHECK_PICTURES, Storage, scheduled_levels


def check_picture_count(patterns: int, interval: int) -> int:
    """Return the number of check pictures of a level.

    One is taken before the first pattern and after each `interval`. A change during the last
    patterns shows in the first check picture of the next level, or of the verification.
    """
    return patterns // interval + 1 if patterns else 0


def check_positions(patterns: int, interval: int) -> Double:
    """Return the index of the pattern before which each check picture is taken, float64."""
    positions = np.arange(check_picture_count(patterns, interval)) * interval
    return np.minimum(positions, patterns).astype(np.float64)


def check_pattern(projector_shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the random pattern of all check pictures, 0 or 1 at each projector ray."""
    lit = random_signs(projector_shape, 1, seed=15)[0] > 0
    return np.asarray(lit if lit.any() else ~lit, np.float32)


def first_check_picture(storage: Storage, references: ReferenceImages) -> MergedImages | None:
    """Merge the acquisition's first check picture; None where there is none."""
    for level in scheduled_levels(storage):
        with suppress(StoreError), storage.partial_brackets(level, CHECK_PICTURES) as store:
            if store.done[0]:
                return references.merge(store.read(0, 1))
    return None


def recovery_advice(storage: Storage, level: int, rig_kind: str = "") -> str:
    """Return the remedies after a capture ended at a level because rig or light changed.

    `rig_kind` is the entry ``kind`` of the rig's description.
    """
    if rig_kind == "offline":
        return "fix this, and take the pictures again; capture.watch: warn continues despite it"
    return storage.recovery_advice(level)
