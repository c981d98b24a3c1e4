"""Ray domains and their block trees (thesis §3.1, §4.2, §5.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Index
from rfpipe.errors import InputError


def ray_shape(shape: tuple[int, ...], name: str = "the ray domain") -> tuple[int, ...]:
    """Validate the shape of a ray domain.

    Parameters
    ----------
    shape : tuple of int
        ``(H, W)``, or the axes of views, then height and width; see `RayDomain`.
    name : str
        Name of the shape in errors.

    Raises
    ------
    InputError
        If it isn't two or more integers of at least 1.
    """
    try:
        lengths = tuple(index(length) for length in shape)
    except TypeError:
        lengths = ()
    if len(lengths) < 2 or min(lengths) < 1:
        raise InputError(
            f"{name} is {shape!r}; expected height and width, (H, W), or axes of views, then "
            "height and width, as (V, H, W), each an integer of at least 1"
        )
    return lengths


@dataclass(frozen=True)
class RayDomain:
    """Index set of the rays of a camera or projector: an image, or several views (a light field).

    Parameters
    ----------
    shape : tuple of int
        ``(H, W)`` for one image; axes of views come first, as in ``(V, H, W)`` or
        ``(rows, columns, H, W)``. Views and rays are numbered in C order. Lengths are at least 1
        and need not be powers of two.

    Raises
    ------
    InputError
        If the shape has fewer than two axes or an empty one.
    """

    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", ray_shape(self.shape))

    @property
    def size(self) -> int:
        """Number of rays."""
        return prod(self.shape)

    @property
    def is_stack(self) -> bool:
        """True if the domain has axes of views, even of a single view."""
        return len(self.shape) > 2

    @property
    def views_shape(self) -> tuple[int, ...]:
        """Lengths of the axes of views; empty for one image."""
        return self.shape[:-2]

    @property
    def views(self) -> int:
        """Number of views."""
        return prod(self.views_shape)

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of a view's image."""
        height, width = self.shape[-2:]
        return height, width

    @property
    def rays_per_image(self) -> int:
        """Number of rays of one view."""
        return prod(self.image_shape)

    @property
    def stack_shape(self) -> tuple[int, int, int]:
        """Number of views, height and width: the shape of all images as one array."""
        return self.views, *self.image_shape

    def square_cells(self, side: int) -> tuple[tuple[int, int, int], NDArray[np.int64]]:
        """Divide the rays into square cells, which may be smaller at the end of an image.

        Returns
        -------
        grid : tuple of int
            Views, rows and columns of cells.
        cell : ndarray of int64, shape (size,)
            Number of each ray's cell, in C order of the grid.
        """
        view, row, column = np.indices(self.stack_shape, np.int64).reshape(3, -1)
        height, width = self.image_shape
        grid = self.views, -(-height // side), -(-width // side)
        return grid, np.ravel_multi_index((view, row // side, column // side), grid)

    @property
    def picture_shape(self) -> tuple[int, int]:
        """Height and width of the images of all views, stacked vertically."""
        height, width = self.image_shape
        return self.views * height, width

    def view_of(self, rays: NDArray[Any]) -> NDArray[Any]:
        """Return the number of each ray's view; -1 for ray -1."""
        return rays // self.rays_per_image


def _halves(position: Index, length: int) -> list[Index]:
    """Halve an axis repeatedly; return for each halving 1 at positions in a second half, else 0."""
    low, high = np.zeros_like(position), np.full_like(position, length)
    second_half = []
    for _ in range((length - 1).bit_length()):
        middle = low + (high - low + 1) // 2
        second = position >= middle
        second_half.append(second.astype(np.int64))
        low, high = np.where(second, middle, low), np.where(second, high, middle)
    return second_half


def _child_numbers(domain: RayDomain) -> Iterator[tuple[Index, int]]:
    """Yield for each level the number of the child block of each ray, and its number of bits.

    Numbers broadcast to the shape of the domain. The first axis has the highest bit, so that the
    numbers of all levels are a Morton code.
    """
    if domain.is_stack:
        view = np.arange(domain.views).reshape(*domain.views_shape, 1, 1)
        yield view, (domain.views - 1).bit_length()
    row, column = np.ogrid[tuple(map(slice, domain.shape))][-2:]
    axes = [_halves(row, domain.shape[-2]), _halves(column, domain.shape[-1])]
    for level in range(max(map(len, axes))):
        bits = [second_half[level] for second_half in axes if level < len(second_half)]
        child = np.zeros((1,) * len(domain.shape), np.int64)
        for bit in bits:
            child = child << 1 | bit
        yield child, len(bits)


class BlockTree:
    """Tree of blocks over a ray domain: a root with all views, one quadtree for each view.

    An axis of odd length splits into a longer first and a shorter second half; a length of one does
    not split. A block in a view therefore has one to four children, and the blocks of the last
    level are single rays. Rays are renumbered in *tree order*, in which every block of every level
    is contiguous: block ``b`` of ``level`` is ``starts[level][b]:starts[level][b + 1]``.

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
        For each level, the first tree position of each block, and last N.
    child_starts : list of ndarray of int64
        For each level except the last: block ``b`` has the children
        ``child_starts[level][b]:child_starts[level][b + 1]``, blocks of the next level.
    """

    def __init__(self, domain: RayDomain) -> None:
        self.domain = domain
        code = np.zeros(domain.shape, np.int64)
        ends = [0]  # number of leading bits of the code that identify a level's blocks
        for child, bits in _child_numbers(domain):
            code = code << bits | child
            ends.append(ends[-1] + bits)
        flat = code.ravel()
        self.order: Index = np.argsort(flat, kind="stable")
        self.inverse: Index = np.empty_like(self.order)
        self.inverse[self.order] = np.arange(domain.size)
        in_order = flat[self.order]
        self.starts: list[Index] = []
        for end in ends:
            block = in_order >> (ends[-1] - end)
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

    def splits_views(self, level: int) -> bool:
        """Return True if the children of the level's blocks are whole views."""
        return level == 0 and self.domain.views > 1

    def n_blocks(self, level: int) -> int:
        """Count the blocks of a level."""
        return len(self.starts[level]) - 1

    def block_of_position(self, level: int) -> NDArray[np.int32]:
        """Return the number of the block at each tree position, shape (N,)."""
        sizes = np.diff(self.starts[level])
        return np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)

    def labels(self, level: int) -> NDArray[np.int32]:
        """Return the number of each ray's block, an int32 image of the domain's shape."""
        return self.block_of_position(level)[self.inverse].reshape(self.domain.shape)

    def ancestors(self, level: int, coarse_level: int) -> Index:
        """Number, at `coarse_level`, of the block that contains each block of `level`."""
        return np.searchsorted(self.starts[coarse_level], self.starts[level][:-1], "right") - 1
