"""Ray domains and their block trees (thesis §3.1, §4.2, §5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

Index = NDArray[np.int64]


@dataclass(frozen=True)
class RayDomain:
    """The index set of one side's rays.

    Parameters
    ----------
    shape : tuple of int
        ``(H, W)`` for one image, ``(V, H, W)`` for a stack of views (a light field).
        Every length is at least 1; no power of two is needed.

    Raises
    ------
    InputError
        If the shape has another number of axes or an empty one.
    """

    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        shape = tuple(int(length) for length in self.shape)
        if len(shape) not in (2, 3) or min(shape) < 1:
            raise InputError(
                f"a ray domain is (H, W) or (V, H, W) with lengths of at least 1, got {self.shape}"
            )
        object.__setattr__(self, "shape", shape)

    @property
    def size(self) -> int:
        """Number of rays."""
        return int(np.prod(self.shape))

    @property
    def is_stack(self) -> bool:
        """Whether the domain is a stack of views."""
        return len(self.shape) == 3


def _halving_path(length: int, depth: int) -> Index:
    """Give, for each position of an axis, its `depth` first-or-second-half choices as bits."""
    position = np.arange(length)
    low, high = np.zeros(length, np.int64), np.full(length, length, np.int64)
    path = np.zeros(length, np.int64)
    for _ in range(depth):
        middle = low + (high - low + 1) // 2
        second = position >= middle
        path = 2 * path + second
        low, high = np.where(second, middle, low), np.where(second, high, middle)
    return path


def _interleave(rows: Index, columns: Index, depth: int) -> Index:
    """Interleave row and column bits (a Morton code), the coarsest level in the highest bits."""
    code = np.zeros(np.broadcast_shapes(rows.shape, columns.shape), np.int64)
    for bit in range(depth):
        code |= ((columns >> bit) & 1) << (2 * bit) | ((rows >> bit) & 1) << (2 * bit + 1)
    return code


class BlockTree:
    """Quadtree over a ray domain; a stack of views first splits into its views.

    A block of odd length splits into a longer first and a shorter second half, a length of one
    does not split, so that a block has one to four children and the last level's blocks are
    single rays. Rays are renumbered in *tree order*, in which every block of every level is one
    contiguous run: block ``b`` of ``level`` is ``starts[level][b]:starts[level][b + 1]``.

    Parameters
    ----------
    domain : RayDomain

    Attributes
    ----------
    order : ndarray of int64, shape (N,)
        Ray index (C order of the domain's shape) at each tree position.
    inverse : ndarray of int64, shape (N,)
        Tree position of each ray.
    starts : list of ndarray of int64
        For each level the first tree position of each block, and N at the end.
    child_starts : list of ndarray of int64
        For each level but the last: the children of block ``b`` are the next level's blocks
        ``child_starts[level][b]:child_starts[level][b + 1]``.
    """

    def __init__(self, domain: RayDomain) -> None:
        self.domain = domain
        height, width = domain.shape[-2:]
        depth = int(max(height, width) - 1).bit_length()
        code = _interleave(
            _halving_path(height, depth)[:, None], _halving_path(width, depth)[None, :], depth
        )
        shifts = [2 * (depth - level) for level in range(depth + 1)]
        if domain.is_stack:
            view = np.arange(domain.shape[0])[:, None, None]
            code = code[None] | view << (2 * depth)
            shifts.insert(0, 62)
        flat = code.ravel()
        self.order: Index = np.argsort(flat, kind="stable")
        self.inverse: Index = np.empty_like(self.order)
        self.inverse[self.order] = np.arange(domain.size)
        in_order = flat[self.order]
        self.starts: list[Index] = []
        for shift in shifts:
            block = in_order >> shift
            first = np.flatnonzero(np.diff(block, prepend=-1))
            self.starts.append(np.append(first, domain.size))
        self.child_starts: list[Index] = [
            np.searchsorted(fine, coarse)
            for coarse, fine in zip(self.starts[:-1], self.starts[1:], strict=True)
        ]

    @property
    def n_levels(self) -> int:
        """Number of levels; level 0 is the root, the last level has single-ray blocks."""
        return len(self.starts)

    def n_blocks(self, level: int) -> int:
        """Count the blocks of a level."""
        return len(self.starts[level]) - 1

    def block_of_position(self, level: int) -> NDArray[np.int32]:
        """Block id at each tree position, shape (N,)."""
        sizes = np.diff(self.starts[level])
        return np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)

    def labels(self, level: int) -> NDArray[np.int32]:
        """Block id of each ray, an int32 image of the domain's shape."""
        return self.block_of_position(level)[self.inverse].reshape(self.domain.shape)

    def ancestors(self, level: int, coarse_level: int) -> Index:
        """Id at `coarse_level` of the block that holds each block of `level`."""
        return np.searchsorted(self.starts[coarse_level], self.starts[level][:-1], "right") - 1
