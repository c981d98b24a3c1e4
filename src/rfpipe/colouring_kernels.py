"""A kernel that colours blocks by who sees them, without any conflict written out."""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["by_saturation"]

_WORD = 64
_LOOKED_AT = 4096  # of equally saturated blocks, the latest to become so; more tell no better
_NONE = -1


@numba.njit(cache=True, nogil=True)
def by_saturation(row_starts, blocks, block_starts, rows):  # type: ignore[no-untyped-def]
    """Colour blocks one by one, always one next to which most colours stand already [DSATUR].

    Of those with equally many, the one next to which most blocks stand; it gets the first colour
    that none of its rows sees.

    Parameters
    ----------
    row_starts, blocks : int32 (rows + 1,), (nnz,)
        The blocks that each row sees.
    block_starts, rows : int32 (n + 1,), (nnz,)
        The rows that see each block.

    Returns
    -------
    int32 (n,)
        Colours 0, 1, ...
    """
    n = len(block_starts) - 1
    neighbours = _neighbours(row_starts, blocks, block_starts, rows)
    colours = np.full(n, _NONE, np.int32)
    beside = np.zeros((n, 1), np.uint64)  # one bit a colour that stands next to a block
    saturation = np.zeros(n, np.int64)
    # blocks of one saturation form a list; those of none are taken by `neighbours`
    latest, after, before = np.full(n + 1, _NONE), np.full(n, _NONE), np.full(n, _NONE)
    unsaturated, taken, highest = np.argsort(-neighbours, kind="mergesort"), 0, 0
    for _ in range(n):
        while highest > 0 and latest[highest] == _NONE:
            highest -= 1
        block = latest[highest] if highest > 0 else _NONE
        if block == _NONE:
            while colours[unsaturated[taken]] != _NONE or saturation[unsaturated[taken]] > 0:
                taken += 1
            block = unsaturated[taken]
        else:
            block = _with_most(block, neighbours, after)
            _unlink(block, highest, latest, after, before)
        colour = _first_zero(beside[block])
        colours[block] = colour
        if colour == _WORD * beside.shape[1]:
            beside = np.concatenate((beside, np.zeros_like(beside)), axis=1)
        word, bit = colour // _WORD, np.uint64(1) << np.uint64(colour % _WORD)
        for row in rows[block_starts[block] : block_starts[block + 1]]:
            for other in blocks[row_starts[row] : row_starts[row + 1]]:
                if colours[other] != _NONE or beside[other, word] & bit:
                    continue
                beside[other, word] |= bit
                level = saturation[other]
                if level > 0:
                    _unlink(other, level, latest, after, before)
                saturation[other] = level = level + 1
                after[other], before[other] = latest[level], _NONE
                if latest[level] != _NONE:
                    before[latest[level]] = other
                latest[level] = other
                highest = max(highest, level)
    return colours


@numba.njit(cache=True)
def _neighbours(row_starts, blocks, block_starts, rows):  # type: ignore[no-untyped-def]
    """Count the blocks that the rows of each block see, itself among them."""
    n = len(block_starts) - 1
    count, counted_for = np.zeros(n, np.int64), np.full(n, _NONE)
    for block in range(n):
        for row in rows[block_starts[block] : block_starts[block + 1]]:
            for other in blocks[row_starts[row] : row_starts[row + 1]]:
                if counted_for[other] != block:
                    counted_for[other] = block
                    count[block] += 1
    return count


@numba.njit(cache=True)
def _with_most(first, neighbours, after):  # type: ignore[no-untyped-def]
    """Return the block next to which most stand, of the first ones of a list."""
    block = other = first
    for _ in range(_LOOKED_AT):
        other = after[other]
        if other == _NONE:
            break
        if neighbours[other] > neighbours[block]:
            block = other
    return block


@numba.njit(cache=True, inline="always")
def _unlink(block, level, latest, after, before):  # type: ignore[no-untyped-def]
    """Take a block out of the list of its saturation."""
    if before[block] == _NONE:
        latest[level] = after[block]
    else:
        after[before[block]] = after[block]
    if after[block] != _NONE:
        before[after[block]] = before[block]


@numba.njit(cache=True, inline="always")
def _first_zero(words):  # type: ignore[no-untyped-def]
    """Return the position of the first bit that isn't set; behind the last one if all are."""
    for word in range(len(words)):
        if words[word] != np.uint64(0xFFFFFFFFFFFFFFFF):
            bit = 0
            while words[word] >> np.uint64(bit) & np.uint64(1):
                bit += 1
            return word * _WORD + bit
    return _WORD * len(words)
