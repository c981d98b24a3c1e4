"""Check of a rig against its calibration, by pictures that every acquisition takes.

A calibration that found the rig coaxial holds until a device is moved or turned, or a cable or menu
changed. Random patterns, or the first check picture, show that before a level is captured.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from rfpipe.errors import CaptureError
from rfpipe.references.check_pictures import check_pattern, first_check_picture, recovery_advice
from rfpipe.references.placement import placement_of
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.references.symmetry import no_longer_coaxial, read_asymmetry
from rfpipe.rigs.calibrated import was_coaxial
from rfpipe.storage.base import LAMP, Storage

_log = logging.getLogger(__name__)


def check_calibration(
    storage: Storage,
    level: int,
    references: ReferenceImages,
    rig: Mapping[str, Any],
    accepted: float,
    *,
    refuse: bool,
) -> None:
    """Check that a rig still is as its calibration found it.

    Parameters
    ----------
    storage : Storage
    level : int
        The level to be captured next, at least 1.
    references : ReferenceImages
    rig : mapping
        Description of the rig. Nothing is checked unless its calibration found it coaxial.
    accepted : float
        Error of relit pictures up to which asymmetry is accepted.
    refuse : bool
        Whether a fault raises an error, or is logged once.

    Raises
    ------
    CaptureError
        If the rig isn't coaxial any more and `refuse` is set.
    """
    if not was_coaxial(rig):
        return
    if read_asymmetry(storage) is None:
        displacement = _displacement_of_check_picture(storage, references)
        text = no_longer_coaxial(displacement) if displacement else ""
    else:
        text = calibration_fault(storage, rig, accepted)
    if not text:
        return
    if refuse:
        raise CaptureError(text, remedy=recovery_advice(storage, 0))
    if level == 1:
        _log.warning("%s", text)


def calibration_fault(storage: Storage, rig: Mapping[str, Any], accepted: float) -> str:
    """Describe the fault that random patterns show of a rig that was coaxial; "" for none.

    Nothing is concluded from pictures whose gain changed from one to the next.
    """
    asymmetry = read_asymmetry(storage)
    if asymmetry is None or not was_coaxial(rig):
        return ""
    if not storage.read_manifest(0, "merge").get(LAMP, {}).get("steady", True):
        return ""
    if asymmetry.excess:
        return asymmetry.text
    is_faulty = asymmetry.place or asymmetry.lower_bound > accepted
    return no_longer_coaxial(asymmetry.text) if is_faulty else ""


def _displacement_of_check_picture(storage: Storage, references: ReferenceImages) -> str:
    """Describe a displacement of the first check picture; "" for a picture in place."""
    first, shape = first_check_picture(storage, references), references.floodlit.shape[:-1]
    if first is None or len(shape) != 2:
        return ""
    pictures, floodlit = (
        np.where(np.isfinite(variance), image, 0).sum(axis=-1, dtype=np.float64)
        for image, variance in (
            (first.radiance, first.variance),
            (references.floodlit, references.floodlit_variance),
        )
    )
    signs = 2 * check_pattern(shape).astype(np.float64) - 1
    return placement_of(signs[None], pictures, floodlit).text
