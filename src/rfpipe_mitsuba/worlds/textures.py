"""Textures by code: letters, checks and blots, as albedos float32 (H, W, 3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator

__all__ = ["blots", "checks", "lettering"]

Picture = NDArray[np.float32]

# Five columns a letter, the lowest bit on top, seven rows.
_FONT = {
    "A": "7e1111117e",
    "D": "7f4141221c",
    "E": "7f49494941",
    "F": "7f09090901",
    "G": "3e4149497a",
    "H": "7f0808087f",
    "I": "00417f4100",
    "L": "7f40404040",
    "N": "7f0408107f",
    "O": "3e4141413e",
    "R": "7f09192946",
    "S": "4649494931",
    "T": "01017f0101",
    "U": "3f4040403f",
    " ": "0000000000",
}
_LINE = 9  # rows of a line, of which two part it from the next


def lettering(
    lines: Sequence[str],
    ink: Sequence[float] = (0.06, 0.06, 0.08),
    paper: Sequence[float] = (0.8, 0.78, 0.7),
    *,
    fine: int = 4,
) -> Picture:
    """Return lines of capitals on paper, all as long as the first.

    Parameters
    ----------
    lines
        Capitals of the built-in font, and blanks.
    ink, paper
        Albedos of red, green and blue.
    fine
        Pixels along either side of a dot of the font.

    Raises
    ------
    KeyError
        When the font has no such letter.
    """
    rows = []
    for line in lines:
        columns = [int(_FONT[letter][k : k + 2], 16) for letter in line for k in range(0, 10, 2)]
        dots = np.array(columns)[None] >> np.arange(_LINE)[:, None] & 1
        spaced = np.pad(dots.reshape(_LINE, len(line), 5), ((0, 0), (0, 0), (0, 1)))
        rows.append(np.pad(spaced.reshape(_LINE, -1), ((0, 0), (1, 0))))
    dotted = np.pad(np.concatenate(rows), ((2, 0), (1, 1)))
    share = np.kron(dotted, np.ones((fine, fine)))[..., None]
    return np.asarray(share * np.array(ink) + (1 - share) * np.array(paper), dtype=np.float32)


def checks(
    rows: int,
    columns: int,
    dark: Sequence[float] = (0.1, 0.12, 0.3),
    light: Sequence[float] = (0.8, 0.75, 0.55),
    *,
    fine: int = 8,
) -> Picture:
    """Return a chessboard of `rows` by `columns` squares, each of `fine` by `fine` pixels."""
    share = (np.add.outer(np.arange(rows), np.arange(columns)) % 2).repeat(fine, 0).repeat(fine, 1)
    mixed = share[..., None] * np.array(dark) + (1 - share[..., None]) * np.array(light)
    return np.asarray(mixed, dtype=np.float32)


def blots(size: int, seed: int, colours: Sequence[Sequence[float]], *, count: int = 60) -> Picture:
    """Return round blots of random places and sizes, of the colours that follow the first's ground.

    Parameters
    ----------
    size
        Pixels along either side.
    seed
        Of places, sizes and colours.
    colours
        Albedos of red, green and blue: of the ground, then of the blots.
    count
        How many blots.
    """
    random = generator(seed)
    picture = np.broadcast_to(np.asarray(colours[0], dtype=np.float32), (size, size, 3)).copy()
    y, x = np.mgrid[:size, :size] / size
    for _ in range(count):
        place, radius = random.random(2), random.uniform(0.02, 0.09)
        within = np.hypot(x - place[0], y - place[1]) < radius
        picture[within] = colours[1 + int(random.integers(len(colours) - 1))]
    return picture
