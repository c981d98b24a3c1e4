"""Today's rig against its calibration, by pictures that an acquisition takes anyway.

A calibration that found the rig coaxial holds until something is moved, turned, or plugged
otherwise. Random patterns, and looks at the rig, show that before a level is captured.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from rfpipe.errors import CaptureError
from rfpipe.references.check_pictures import check_pattern, first_check_picture, recovery_advice
from rfpipe.references.placement import placement_of
from rfpipe.references.reference_images import Merger
from rfpipe.references.symmetry import no_longer_coaxial, read_asymmetry
from rfpipe.rigs.calibrated import was_coaxial
from rfpipe.storage.files import LAMP, AcquisitionFolder

_log = logging.getLogger(__name__)


def check(
    folder: AcquisitionFolder,
    level: int,
    merger: Merger,
    rig: Mapping[str, Any],
    accepted: float,
    *,
    refuse: bool,
) -> None:
    """Refuse a rig that isn't as its calibration found it, or warn of it.

    Parameters
    ----------
    level : int
        The level that is about to be captured, not 0.
    rig : mapping
        The rig's description; nothing is checked unless its calibration found it coaxial.
    accepted : float
        Error of relit pictures up to which asymmetry is accepted.
    refuse : bool
        Whether to raise CaptureError.
    """
    if not was_coaxial(rig):
        return
    if read_asymmetry(folder) is None:
        place = _placement_by_look(folder, merger)
        text = no_longer_coaxial(place) if place else ""
    else:
        text = alarm(folder, rig, accepted)
    if not text:
        return
    if refuse:
        raise CaptureError(f"{text}. {recovery_advice(folder, 0)}")
    if not any(folder.levels_above(level)[1:]):  # once
        _log.warning("%s", text)


def alarm(folder: AcquisitionFolder, rig: Mapping[str, Any], accepted: float) -> str:
    """Describe what random patterns show of a rig that was coaxial; "" for nothing wrong.

    Gain that changes from picture to picture makes any rig seem wrong.
    """
    asymmetry = read_asymmetry(folder)
    if asymmetry is None or not was_coaxial(rig):
        return ""
    if not folder.read_manifest(0, "merge").get(LAMP, {}).get("steady", True):
        return ""
    if asymmetry.excess:
        return asymmetry.text
    is_wrong = asymmetry.place or asymmetry.least > accepted
    return no_longer_coaxial(asymmetry.text) if is_wrong else ""


def _placement_by_look(folder: AcquisitionFolder, merger: Merger) -> str:
    """Describe a wrong place of the first look's picture, "" for a right one."""
    look, shape = first_check_picture(folder, merger), merger.floodlit.shape[:-1]
    if look is None or len(shape) != 2:
        return ""
    pictures, floodlit = (
        np.where(np.isfinite(variance), image, 0).sum(axis=-1, dtype=np.float64)
        for image, variance in (
            (look.radiance, look.variance),
            (merger.floodlit, merger.floodlit_variance),
        )
    )
    signs = 2 * check_pattern(shape).astype(np.float64) - 1
    return placement_of(signs[None], pictures, floodlit).text
