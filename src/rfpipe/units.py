"""Dtypes, units and limits of counts, and the keys of brackets that aren't a level's patterns."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

NumberFormat = Literal["float32", "uint16", "uint8"]
"""How a stored transport keeps its numbers: as they are, or rounded to 16 or 8 bits."""

RADIANCE = np.float32
"""Dtype of stored radiance, and of its variance (radiance squared)."""

COUNTS = np.uint16
"""Dtype of raw frames, in analogue-to-digital counts."""

RADIANCE_UNIT = "radiance"
"""Scene-referred linear light, in units of the coaxial transport matrix."""

COUNT_UNIT = "count"
"""One step of the camera's analogue-to-digital converter."""

SATURATION_FRACTION = 0.98
"""Fraction of full scale from which on a count is saturated, where nothing else is set."""

SYMMETRY_FRAMES = 6  # four say the same within 20 %, eight within 10 %
"""Random patterns that tell whether a rig is coaxial."""

BLACK_LEVEL_KEY = 1_000_000
"""First part of the keys of all-off brackets, where patterns have their level: (this, i)."""

FLOODLIT_KEY = 1_000_001
"""The same of the all-on brackets that an acquisition begins with."""

WARM_UP_KEY = 1_000_003
"""The same of those that are shown while the lamp warms up, and not kept."""

SYMMETRY_KEY = 1_000_004
"""The same of the random patterns that tell whether a rig is coaxial: (this, i)."""

VERIFICATION_KEY = 1_000_005
"""The same of pictures that no method saw, taken to verify a transport: (this, i)."""

CHECK_PICTURE_KEY = 1_000_006
"""The same of check pictures, by which changes of rig and light are noticed: (this, level, i)."""

SEQUENCE_KEY = 1_000_007
"""The same of what a sequence shows beside its patterns: (this, ...)."""

_PICTURES = {
    BLACK_LEVEL_KEY: "all-off reference picture",
    FLOODLIT_KEY: "all-on reference picture",
    WARM_UP_KEY: "warm-up picture",
    SYMMETRY_KEY: "random pattern of the symmetry test,",
    VERIFICATION_KEY: "verification picture",
    CHECK_PICTURE_KEY: "check picture",
    SEQUENCE_KEY: "reference picture of a sequence,",
}


def picture_name(key: Sequence[int]) -> str:
    """Name of the picture with a key, for messages: of what kind it is, and its number from 0.

    A pattern of a level is ``pattern (level, index)``.
    """
    kind, *rest = (int(part) for part in key)
    if kind not in _PICTURES:
        return f"pattern {(kind, *rest)}"
    return f"{_PICTURES[kind]} {rest[-1] if rest else 0}"
