"""Albedo of the surfaces: plain white, or a printed page of text-like strokes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import generator

WHITE = 0.8
PAPER = 0.85
INK = 0.15

# Colour of each surface of an RGB scene: factors of its albedo around one, so that the surfaces
# differ in colour, the middle channel is the grey scene's and no albedo comes near 1.
TINTS = ((1.04, 1.0, 0.92), (0.94, 1.0, 1.05), (1.08, 1.0, 1.02))

# A printed page at the run's resolution, in pixels.
_LETTER_HEIGHT = 7
_LEADING = 9  # from one line of text to the next
_LETTER_WIDTHS = (4, 6)  # bounds, inclusive
_WORD_LENGTHS = (2, 7)  # letters


def require_kinds(surfaces: Sequence[str], geometry: str, names: Sequence[str]) -> None:
    """Raise InputError where the kinds of surfaces don't fit those that a geometry names."""
    if len(surfaces) != len(names) or not set(surfaces) <= {"white", "texture"}:
        raise InputError(
            f"surfaces {tuple(surfaces)} of geometry {geometry!r}: expected {len(names)} "
            f"({', '.join(names)}), each 'white' or 'texture'"
        )


def printed_page(shape: tuple[int, int], seed: int, page: int = 0) -> NDArray[np.bool_]:
    """Lines of words of letter-like strokes, one to two pixels wide: bool (H, W), True for ink.

    Pages of one seed differ by their number.
    """
    random = generator(seed, page)
    # a page with margins, so wide that no word that begins within it goes beyond
    margin, word = _LETTER_HEIGHT, _WORD_LENGTHS[1] * (_LETTER_WIDTHS[1] + 1)
    height, width = shape[0] + margin, shape[1] + margin
    ink = np.zeros((height + margin, width + word), dtype=np.bool_)
    for top in range(margin + int(random.integers(-_LETTER_HEIGHT, 1)), height, _LEADING):
        left = margin + int(random.integers(-_LETTER_WIDTHS[1], 1))
        while left < width:
            for _ in range(random.integers(_WORD_LENGTHS[0], _WORD_LENGTHS[1] + 1)):
                letter = _letter(random)
                ink[top : top + _LETTER_HEIGHT, left : left + letter.shape[1]] |= letter
                left += letter.shape[1] + 1
            left += int(random.integers(1, 4))
    return ink[margin:height, margin:width]


def _letter(random: np.random.Generator) -> NDArray[np.bool_]:
    """A stem on the left and two or three more strokes, like a capital's."""
    width = int(random.integers(_LETTER_WIDTHS[0], _LETTER_WIDTHS[1] + 1))
    letter = np.zeros((_LETTER_HEIGHT, width), dtype=np.bool_)
    letter[:, : random.integers(1, 3)] = True
    rows = np.arange(_LETTER_HEIGHT)
    slant = 1 + rows * (width - 2) // (_LETTER_HEIGHT - 1)
    for stroke in random.choice(6, size=random.integers(2, 4), replace=False):
        if stroke < 3:  # a bar at the top, in the middle or at the foot
            letter[stroke * (_LETTER_HEIGHT - 1) // 2] = True
        elif stroke == 3:
            letter[:, -1] = True
        else:
            letter[rows, slant if stroke == 4 else slant[::-1]] = True
    return letter


def surface_albedo(
    kind: str,
    shape: tuple[int, int],
    channels: int,
    seed: int,
    surface: int,
    tint: tuple[float, float, float] | None = None,
) -> NDArray[np.float64]:
    """Albedo of one surface over an image or its own texels: float64 (H, W, C) in [0, 1].

    Parameters
    ----------
    kind
        ``"white"`` or ``"texture"``.
    channels
        1 (grey) or 3 (RGB, tinted); InputError for another number.
    surface
        Number of the surface: its page and its tint.
    tint
        Factors of the albedo in red, green and blue, instead of those in `TINTS`; a grey surface
        takes the middle one.
    """
    if channels not in (1, 3):
        raise InputError(f"channels {channels}: expected 1 (grey) or 3 (RGB)")
    grey = np.full(shape, WHITE)
    if kind == "texture":
        grey = np.where(printed_page(shape, seed, surface), INK, PAPER)
    factors = np.array(tint or TINTS[surface % len(TINTS)])
    albedo: NDArray[np.float64] = grey[..., None] * (factors if channels > 1 else factors[1:2])
    return albedo
