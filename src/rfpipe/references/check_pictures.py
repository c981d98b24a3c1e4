"""Check pictures: repeated pictures of one random pattern, taken between the patterns of a level.

A difference between a check picture and the first one shows that the rig or its light changed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.symmetry import random_signs
from rfpipe.errors import StoreError
from rfpipe.photometry.sensor import Merged
from rfpipe.references.reference_images import Merger
from rfpipe.storage.files import (
    CHECK_PICTURES,
    AcquisitionFolder,
)

Double = NDArray[np.float64]


def check_picture_count(patterns: int, every: int) -> int:
    """Return the looks at a level: one before each `every` patterns, and one after the last."""
    return -(-patterns // every) + 1


def check_positions(patterns: int, every: int) -> Double:
    """Return before which pattern each look is taken."""
    return np.minimum(np.arange(check_picture_count(patterns, every)) * every, patterns).astype(
        np.float64
    )


def check_pattern(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the random pattern that looks repeat, over the projector's rays."""
    lit = random_signs(shape, 1, seed=15)[0] > 0
    return np.asarray(lit if lit.any() else ~lit, np.float32)


def first_check_picture(folder: AcquisitionFolder, merger: Merger) -> Merged | None:
    """Merge the acquisition's first look, with which others are compared; None without one."""
    for level in folder.levels():
        try:
            with folder.open_frames(level, CHECK_PICTURES) as frames:
                if frames.done[0]:
                    return merger.merge(frames.read(0, 1), 0)
        except StoreError:  # not taken yet, or damaged
            continue
    return None


def recovery_advice(folder: AcquisitionFolder, level: int, kind: str = "") -> str:
    """Describe ways on from a capture that ended at a level since the rig or its light changed.

    `kind` is the rig's.
    """
    if kind == "offline":
        return "mend it, and take the pictures again; capture.watch: warn goes on all the same"
    if not folder.is_kept:
        return "watch='warn' goes on all the same"
    ways = (
        f"all that is captured is kept. To begin anew: '{folder.retaking()}', with the run's other "
        "options. "
    )
    if level:
        ways += (
            f"Or put back what changed: '{folder.retaking(level)}' takes this level alone again, "
            "if the pattern looks as it did first. "
        )
    return f"{ways}capture.watch: warn goes on all the same"
