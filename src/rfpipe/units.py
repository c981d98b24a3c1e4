"""Dtypes, units and limits of counts; keys of brackets that don't belong to a level."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

NumberFormat = Literal["float32", "uint16", "uint8"]
NormalizationMode = Literal["none", "per_channel", "total_energy"]
"""Type of the numbers in a stored transport: float32, or rounded to 16 or 8 bits."""

RADIANCE = np.float32
"""Dtype of stored radiance, and of its variance (radiance squared)."""

COUNTS = np.uint16
"""Dtype of raw frames, in analogue-to-digital counts."""

RADIANCE_UNIT = "radiance"
"""Scene-referred linear light, in units of the coaxial transport matrix."""

COUNT_UNIT = "count"
"""One step of the camera's analogue-to-digital converter."""

SATURATION_FRACTION = 0.98
"""Least saturated count as a fraction of full scale, unless a setting gives another one."""

SYMMETRY_BRACKETS = 6  # results of 4 patterns differ by up to 20 %, of 8 patterns by up to 10 %
"""Number of random patterns of the symmetry test."""

# A bracket's key is (level, index) for a pattern of a level, and (one of the following numbers,
# index) for any other picture; a check picture has (CHECK_PICTURE_KEY, level, index).

BLACK_LEVEL_KEY = 1_000_000
"""First part of the keys of all-off reference brackets."""

FLOODLIT_KEY = 1_000_001
"""First part of the keys of all-on reference brackets, taken when an acquisition begins."""

WARM_UP_KEY = 1_000_003
"""First part of the keys of pictures taken while the lamp warms up, which are not stored."""

SYMMETRY_KEY = 1_000_004
"""First part of the keys of the random patterns of the symmetry test."""

VERIFICATION_KEY = 1_000_005
"""First part of the keys of held-out pictures, taken to verify a transport."""

CHECK_PICTURE_KEY = 1_000_006
"""First part of the keys of check pictures: a random pattern, repeated to detect changes."""

SEQUENCE_KEY = 1_000_007
"""First part of the keys of a hardware sequence's reference pictures."""

_KINDS = {
    BLACK_LEVEL_KEY: "all-off reference picture",
    FLOODLIT_KEY: "all-on reference picture",
    WARM_UP_KEY: "warm-up picture",
    SYMMETRY_KEY: "random pattern of the symmetry test,",
    VERIFICATION_KEY: "verification picture",
    CHECK_PICTURE_KEY: "check picture",
    SEQUENCE_KEY: "reference picture of a sequence,",
}


def picture_name(key: Sequence[int]) -> str:
    """Describe the picture with a key in messages: its kind, and its number from 0.

    A pattern of a level is ``pattern (level, index)``.
    """
    first, *indices = (int(part) for part in key)
    if first not in _KINDS:
        return f"pattern {(first, *indices)}"
    return f"{_KINDS[first]} {indices[-1] if indices else 0}"
