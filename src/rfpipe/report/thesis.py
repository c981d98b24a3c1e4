"""What the thesis measured: Tables 3.1 and 5.1, for comparison."""

from __future__ import annotations

from dataclasses import dataclass

from rfpipe.config import SceneSettings
from rfpipe.scenes import REFERENCE_SCENES

__all__ = [
    "DUAL_ON_SCENE_IV",
    "PLANES_SHAPE",
    "TABLE_3_1",
    "TABLE_5_1",
    "DualResult",
    "SymmetricResult",
    "numeral_of",
    "row_of",
]

PLANES_SHAPE = (310, 350)
"""Rays of scenes I to IV of Fig. 2.1 in the thesis."""

DUAL_ON_SCENE_IV = 7382
"""Patterns of dual photography on scene IV [Fig. 5.9]."""


@dataclass(frozen=True)
class SymmetricResult:
    """A row of Table 5.1: megabytes, minutes, patterns; 2 s a HDR image."""

    megabytes: float
    minutes: float
    patterns: int
    brute_force_patterns: int


@dataclass(frozen=True)
class DualResult:
    """A row of Table 3.1; 25 patterns a minute."""

    dense_terabytes: float
    brute_force_days: float
    megabytes: float
    minutes: float
    patterns: int


_LIGHT_FIELD = "Fig. 5.8, 8D"

TABLE_5_1 = {
    "Fig. 2.1 (I)": SymmetricResult(255, 44, 809, 108_500),
    "Fig. 2.1 (II)": SymmetricResult(371, 70, 1085, 108_500),
    "Fig. 2.1 (III)": SymmetricResult(334, 65, 1081, 108_500),
    "Fig. 2.1 (IV)": SymmetricResult(274, 46, 841, 108_500),
    "Fig. 5.6, gummy bears": SymmetricResult(337, 151, 2417, 91_176),
    _LIGHT_FIELD: SymmetricResult(1470, 484, 3368, 233_657),
}

TABLE_3_1 = {
    "Fig. 3.4, box": DualResult(3.7, 7.3, 179, 14, 352),
    "Fig. 3.7, top": DualResult(1.6, 8.3, 56, 19, 501),
    "Fig. 3.7, bottom": DualResult(1.4, 8.3, 139, 15, 369),
    "Fig. 3.6, bottle": DualResult(5.4, 10.9, 272, 136, 3397),
    "Fig. 3.9, 80 positions": DualResult(114, 362, 6675, 1761, 19_140),
}


def numeral_of(scene: SceneSettings) -> str | None:
    """Return which scene of Fig. 2.1 a configured one is, ``"I"`` to ``"IV"``; None for others."""
    options = scene.options()
    if options.get("occluders") or not scene.is_coaxial:
        return None
    own = (scene.kind, tuple(options.get("surfaces", ())))
    return next((numeral for numeral, known in REFERENCE_SCENES.items() if known == own), None)


def row_of(scene: SceneSettings) -> str | None:
    """Return the row of Table 5.1 that a configured scene can stand beside; None for others."""
    if scene.is_light_field:
        return _LIGHT_FIELD
    numeral = numeral_of(scene)
    return numeral and f"Fig. 2.1 ({numeral})"
