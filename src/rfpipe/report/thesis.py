"""What the thesis measured and claims: Tables 3.1 and 5.1, and its figures, for comparison."""

from __future__ import annotations

from dataclasses import dataclass

from rfpipe.config import SceneSettings
from rfpipe.scenes import REFERENCE_SCENES

__all__ = [
    "CLAIMS",
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

CLAIMS = {
    "Fig. 2.1": "the matrices are symmetric; a flat diffuse plane's is diagonal; light from one "
    "plane to another is smooth, and texture scales its rows and columns alone, so that blocks "
    "away from the diagonal have rank 1.",
    "Fig. 3.1": "a projector of 8 by 8 pixels takes 21 patterns with the conflicts drawn there and "
    "13 without any, in place of 64.",
    "Fig. 3.2": "patterns adapt to the scene: where a bottle spreads light only few pixels can be "
    "lit at once, elsewhere many.",
    "Fig. 3.3": "down to single pixels the diffuse light from the red wall to the box is lost in "
    "the camera's noise; stored hierarchically it is kept.",
    "Fig. 3.4": "the dual image is the sum of the images of all levels, coarse ones with the "
    "diffuse inter-reflection that finer ones would lose.",
    "Fig. 3.6": "light through a bottle is captured: caustics, seen from the camera and from the "
    "projector, vary with a high-frequency pattern that relights the dual image.",
    "Fig. 3.7": "the dual image shows what the camera hardly sees, such as detail on a pillar that "
    "is foreshortened to it.",
    "Fig. 3.8": "patterns grow with the logarithm of the projector's resolution, for the box and "
    "the bottle.",
    "Fig. 3.9": "of 80 camera positions each becomes a light: from the left, from the right, all "
    "together an area light with soft shadows, and a high-resolution matte.",
    "Fig. 3.10": "with camera and projector at right angles much of the dual image rests on coarse "
    "levels and is blurred, yet the mirror's reflection is there.",
    "Fig. 5.6": "letters of light relight gummy bears from the front, with even light from behind, "
    "too, as the real projectors do.",
    "Fig. 5.7": "stopped at any level, the picture has full resolution, but the pattern's light is "
    "spread over each block that it touches.",
    "Fig. 5.8": "from nine views and in nine lights: shadows move with the light, and parallax "
    "with the view.",
    "Fig. 5.9": "symmetric photography resolves the fine texture in indirect light with 841 "
    "patterns, dual photography blurs it with 7,382.",
    "Fig. 5.10": "at levels 4 to 9 a significant share of the leaves has rank 1, and a flat plane "
    "has far more empty ones than two planes at an angle.",
    "Fig. 5.11": "lens flare in the camera alone breaks the symmetry: a tight threshold corrupts "
    "the highlights, a loose one makes that less noticeable.",
    "Fig. B.1": "the sum of the images of single pixels is dimmer and paler than the floodlit "
    "image; normalization restores it.",
    "Table 3.1": "dual photography takes orders of magnitude less time and space than a "
    "brute-force scan: 352 to 19,140 patterns.",
    "Table 5.1": "symmetric photography takes 809 to 3,368 patterns where brute force takes 91,176 "
    "to 233,657.",
}
"""What the thesis' own figures and tables show, by their names."""


def numeral_of(scene: SceneSettings) -> str | None:
    """Return which scene of Fig. 2.1 a configured one is, ``"I"`` to ``"IV"``; None for others."""
    options = scene.options()
    if options.get("occluders") or not scene.is_coaxial:
        return None
    own = (scene.kind, tuple(options.get("surfaces", ())))
    return next((numeral for numeral, known in REFERENCE_SCENES.items() if known == own), None)


def row_of(scene: SceneSettings) -> str | None:
    """Return the row of Table 5.1 that a configured scene can stand beside; None for others."""
    if scene.is_coaxial and min(scene.view_grid) > 1:  # a planar array
        return _LIGHT_FIELD
    numeral = numeral_of(scene)
    return numeral and f"Fig. 2.1 ({numeral})"
