"""Fault that check pictures taken in direct succession show: gain, flicker, order, room light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.references.comparison import compare_pictures
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.references.steadiness import (
    Samples,
    camera_model_of,
    motion_of,
    sample_pixels,
    unsteadiness_of,
)
from rfpipe.rigs.faults import NOTED, Fault, room_fault

Brackets = Sequence[NDArray[Any]]
"""Brackets (1, E, ...) of one pattern, taken in direct succession."""


def gain_fault_of_repeats(repeats: Brackets, references: ReferenceImages) -> Fault | None:
    """Return the fault of gain, lamp or frame order that repeats show; None for exact radiance."""
    camera = camera_model_of(references.merge.sensor)
    return None if camera is None else unsteadiness_of(_samples(repeats, references), camera)


def fault_of_repeats(repeats: Brackets, references: ReferenceImages) -> Fault | None:
    """Return the fault of gain, lamp, frame order or room light that repeats show.

    None where nothing but noise differs, and where the shape of the picture changes, too.
    """
    gain_fault = gain_fault_of_repeats(repeats, references)
    is_certain = gain_fault is not None and gain_fault.kind in ("flicker", "late")
    fault = gain_fault if is_certain else _room_fault_of(repeats, references) or gain_fault
    camera = camera_model_of(references.merge.sensor)
    if fault is None or fault.kind == "late" or camera is None:
        return fault
    return None if motion_of(_samples(repeats, references), camera) is not None else fault


def _room_fault_of(repeats: Brackets, references: ReferenceImages) -> Fault | None:
    """Return the fault of room light that changes between repeats."""
    first = references.merge(repeats[0])
    room = [compare_pictures(references, first, bracket).room for bracket in repeats[1:]]
    fault = room_fault(max(map(abs, room)), f"in {len(repeats)} pictures")
    return fault if fault.exceeds(NOTED) else None


def _samples(repeats: Brackets, references: ReferenceImages) -> Samples:
    counts = np.stack([sample_pixels(bracket[0]) for bracket in repeats])
    return Samples(counts, sample_pixels(references.merge.black))
