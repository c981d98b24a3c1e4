"""Random patterns of the residual's rounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
from rfpipe.transport.wavelet import Cells

PATTERN_SEED = 2006
"""Seed of random blocks, and of the patterns of near/far acquisition: keys differ between both."""

# Share of the blocks that a pattern lights. At 48 x 48, a tenth gave the same errors.
_LIT = 0.3


def block_patterns(cells: Cells, key: int, count: int) -> NDArray[np.bool_]:
    """Draw patterns of random blocks of 1, 2, 4 and 8 cells per side in turn.

    Parameters
    ----------
    cells : Cells
        The cells of the projector.
    key : int
        Number of the round over all phases, `Round.key`. A pattern depends on `key` and its index.
    count : int

    Returns
    -------
    ndarray of bool, shape (count, *cells.shape)
    """
    views, height, width = cells.stack
    patterns = np.zeros((count, *cells.shape), np.bool_)
    for index in range(count):
        random = generator(PATTERN_SEED, key, index)
        side = 2 ** (index % 4)
        first_row, first_column = random.integers(0, side, 2)
        grid = (views, height // side + 2, width // side + 2)
        blocks = (random.random(grid) < _LIT).repeat(side, axis=1).repeat(side, axis=2)
        lit = blocks[:, first_row : first_row + height, first_column : first_column + width]
        patterns[index] = lit.reshape(-1)[cells.of_ray].reshape(cells.shape)
    return patterns
