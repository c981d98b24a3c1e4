"""Greedy colouring of blocks by saturation [D. Brelaz, DSATUR, 1979], without a list of conflicts.

Two blocks are neighbours where a row of a sparse matrix has both: they need different colours. The
saturation of a block is the number of colours of its neighbours. Blocks are coloured one by one:
always one of the highest saturation and, of those, the one with the most neighbours.

=====================  ============================  ==============================================
name                   shape                         meaning
=====================  ============================  ==============================================
row_starts, blocks     (rows + 1,), (nnz,) int32     blocks of each row of a CSR matrix
block_starts, rows     (n + 1,), (nnz,) int32        rows of each block of a CSC matrix
excluded               (n, words) uint64             colours of each block's neighbours, one bit for
                                                     each colour
newest                 (n + 1,) int64                by saturation: the block that reached it last
next, previous         (n,) int64                    links of the blocks of one saturation
=====================  ============================  ==============================================
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["colour_by_saturation"]

_WORD = 64
_COMPARED = 4096  # blocks of one saturation, the newest, whose neighbours are compared
_NONE = -1


class _Incidence(NamedTuple):
    """Rows and blocks of a sparse matrix."""

    row_starts: NDArray[np.int32]
    blocks: NDArray[np.int32]
    block_starts: NDArray[np.int32]
    rows: NDArray[np.int32]


class _Queue(NamedTuple):
    """Linked lists of uncoloured blocks by saturation, from 1."""

    saturation: NDArray[np.int64]
    newest: NDArray[np.int64]
    next: NDArray[np.int64]
    previous: NDArray[np.int64]


@numba.njit(cache=True, nogil=True)
def colour_by_saturation(row_starts, blocks, block_starts, rows):  # type: ignore[no-untyped-def]
    """Colour blocks so that no row has two blocks of one colour; see the module for arguments.

    Returns
    -------
    int32 (n,)
        Colours 0, 1, ...
    """
    incidence = _Incidence(row_starts, blocks, block_starts, rows)
    n = len(block_starts) - 1
    n_neighbours = _count_neighbours(incidence)
    unsaturated, position = np.argsort(-n_neighbours, kind="mergesort"), 0
    colours = np.full(n, _NONE, np.int32)
    excluded = np.zeros((n, 1), np.uint64)
    queue = _Queue(
        np.zeros(n, np.int64), np.full(n + 1, _NONE), np.full(n, _NONE), np.full(n, _NONE)
    )
    highest = 0
    for _ in range(n):
        while highest > 0 and queue.newest[highest] == _NONE:
            highest -= 1
        if highest == 0:
            while (
                colours[unsaturated[position]] != _NONE
                or queue.saturation[unsaturated[position]] > 0
            ):
                position += 1
            block = unsaturated[position]
        else:
            block = _with_most_neighbours(queue, highest, n_neighbours)
            _unlink(queue, block)
        colour = _first_zero(excluded[block])
        colours[block] = colour
        if colour == _WORD * excluded.shape[1]:
            excluded = np.concatenate((excluded, np.zeros_like(excluded)), axis=1)
        highest = max(highest, _exclude(incidence, block, colour, colours, excluded, queue))
    return colours


@numba.njit(cache=True)
def _exclude(incidence, block, colour, colours, excluded, queue):  # type: ignore[no-untyped-def]
    """Exclude a block's colour for its uncoloured neighbours; return their highest saturation."""
    word, bit = colour // _WORD, np.uint64(1) << np.uint64(colour % _WORD)
    highest = 0
    for k in range(incidence.block_starts[block], incidence.block_starts[block + 1]):
        row = incidence.rows[k]
        for neighbour in incidence.blocks[
            incidence.row_starts[row] : incidence.row_starts[row + 1]
        ]:
            if colours[neighbour] != _NONE or excluded[neighbour, word] & bit:
                continue
            excluded[neighbour, word] |= bit
            if queue.saturation[neighbour] > 0:
                _unlink(queue, neighbour)
            queue.saturation[neighbour] += 1
            _link(queue, neighbour)
            highest = max(highest, queue.saturation[neighbour])
    return highest


@numba.njit(cache=True)
def _count_neighbours(incidence):  # type: ignore[no-untyped-def]
    """Count the neighbours of each block, the block itself included."""
    n = len(incidence.block_starts) - 1
    count, counted_for = np.zeros(n, np.int64), np.full(n, _NONE)
    for block in range(n):
        for k in range(incidence.block_starts[block], incidence.block_starts[block + 1]):
            row = incidence.rows[k]
            start, end = incidence.row_starts[row], incidence.row_starts[row + 1]
            for neighbour in incidence.blocks[start:end]:
                count[block] += counted_for[neighbour] != block
                counted_for[neighbour] = block
    return count


@numba.njit(cache=True)
def _with_most_neighbours(queue, saturation, n_neighbours):  # type: ignore[no-untyped-def]
    """Return the block with the most neighbours among the newest blocks of a saturation."""
    best = block = queue.newest[saturation]
    for _ in range(_COMPARED):
        block = queue.next[block]
        if block == _NONE:
            break
        if n_neighbours[block] > n_neighbours[best]:
            best = block
    return best


@numba.njit(cache=True, inline="always")
def _link(queue, block):  # type: ignore[no-untyped-def]
    """Add a block to the list of its saturation."""
    saturation = queue.saturation[block]
    newest = queue.newest[saturation]
    queue.next[block], queue.previous[block] = newest, _NONE
    if newest != _NONE:
        queue.previous[newest] = block
    queue.newest[saturation] = block


@numba.njit(cache=True, inline="always")
def _unlink(queue, block):  # type: ignore[no-untyped-def]
    """Remove a block from the list of its saturation."""
    if queue.previous[block] == _NONE:
        queue.newest[queue.saturation[block]] = queue.next[block]
    else:
        queue.next[queue.previous[block]] = queue.next[block]
    if queue.next[block] != _NONE:
        queue.previous[queue.next[block]] = queue.previous[block]


@numba.njit(cache=True, inline="always")
def _first_zero(words):  # type: ignore[no-untyped-def]
    """Return the position of the first bit that is 0, or the number of bits if all are 1."""
    for word in range(len(words)):
        if words[word] != np.uint64(0xFFFFFFFFFFFFFFFF):
            bit = 0
            while words[word] >> np.uint64(bit) & np.uint64(1):
                bit += 1
            return word * _WORD + bit
    return _WORD * len(words)
