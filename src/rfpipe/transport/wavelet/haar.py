"""The orthonormal Haar transform of images on a grid, and where its functions are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.base import Float

__all__ = ["Group", "Haar"]

_HALF = np.float32(0.5)
_COARSEST = 3  # cells along the shorter side of the coarsest grid, at least


@dataclass(frozen=True)
class Group:
    """Functions of one scale.

    Attributes
    ----------
    start : int
        The first of them.
    orientations : int
        3 of details, 1 of the coarsest means. Functions come orientation by orientation.
    grid : tuple of int
        Views, rows, columns of the places of either orientation.
    side : int
        Of a function's support, in cells.
    """

    start: int
    orientations: int
    grid: tuple[int, int, int]
    side: int

    @property
    def places(self) -> int:
        """Number of places."""
        return math.prod(self.grid)

    @property
    def rows(self) -> slice:
        """Which of all functions they are."""
        return slice(self.start, self.start + self.orientations * self.places)

    def alike(self) -> list[NDArray[np.int64]]:
        """Return the functions of each place; of the finest scale, those of two by two places."""
        _, height, width = self.grid
        step = 2 if self.side == 2 and height % 2 == 0 and width % 2 == 0 else 1
        number = np.arange(self.rows.start, self.rows.stop)
        shape = (self.orientations, self.grid[0], height // step, step, width // step, step)
        places = number.reshape(shape).transpose(1, 2, 4, 0, 3, 5)
        return list(places.reshape(-1, self.orientations * step * step))

    def centres(self) -> NDArray[np.float32]:
        """Row and column of the middle of each place in its view, in cells, (places, 2)."""
        _, row, column = np.indices(self.grid).reshape(3, -1)
        places: Float = (np.stack([row, column], axis=1).astype(np.float32) + _HALF) * self.side
        return places


def _padded(side: int, octaves: int) -> int:
    """Return the cells along a side that halves so many times."""
    cell = 1 << octaves
    return -(-side // cell) * cell


class Haar:
    """The transform of images of a stack's cells.

    Parameters
    ----------
    stack : tuple of int
        Views, rows and columns of cells. Views aren't mixed.
    """

    def __init__(self, stack: tuple[int, int, int]) -> None:
        views, height, width = self.stack = stack
        self.octaves = max(0, int(np.log2(max(1.0, min(height, width) / _COARSEST))))
        self.grid = (views, _padded(height, self.octaves), _padded(width, self.octaves))
        self.size = math.prod(self.grid)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The scales, from the finest; the coarsest means are the last."""
        views, height, width = self.grid
        found, start = [], 0
        for octave in range(1, self.octaves + 1):
            side = 2**octave
            found.append(Group(start, 3, (views, height // side, width // side), side))
            start = found[-1].rows.stop
        side = 2**self.octaves
        found.append(Group(start, 1, (views, height // side, width // side), side))
        return tuple(found)

    def forward(self, images: Float) -> Float:
        """Return the coefficients (size, M) of images (cells, M)."""
        views, height, width = self.stack
        count = images.shape[1]
        rest = np.zeros((*self.grid, count), np.float32)
        rest[:, :height, :width] = images.reshape(*self.stack, count)
        found = np.empty((self.size, count), np.float32)
        for group in self.groups[:-1]:
            _, h, w = group.grid
            quads = rest.reshape(views, h, 2, w, 2, count)
            up, down = quads[:, :, 0], quads[:, :, 1]
            total, change = _HALF * (up + down), _HALF * (up - down)
            details = found[group.rows].reshape(3, *group.grid, count)
            np.subtract(total[..., 0, :], total[..., 1, :], out=details[0])
            np.add(change[..., 0, :], change[..., 1, :], out=details[1])
            np.subtract(change[..., 0, :], change[..., 1, :], out=details[2])
            rest = total[..., 0, :] + total[..., 1, :]
        found[self.groups[-1].rows] = rest.reshape(-1, count)
        return found

    def inverse(self, found: Float) -> Float:
        """Return the images (cells, M) of coefficients (size, M)."""
        count, (views, height, width) = found.shape[1], self.stack
        last = self.groups[-1]
        rest: Float = found[last.rows].reshape(*last.grid, count)
        for group in reversed(self.groups[:-1]):
            across, along, both = _HALF * found[group.rows].reshape(3, *group.grid, count)
            rest, (_, h, w) = _HALF * rest, group.grid
            quads = np.empty((views, h, 2, w, 2, count), np.float32)
            for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
                one, other = (1 - 2 * column), (1 - 2 * row)
                quads[:, :, row, :, column] = (
                    rest + one * across + other * along + one * other * both
                )
            rest = quads.reshape(views, 2 * h, 2 * w, count)
        return np.ascontiguousarray(rest[:, :height, :width]).reshape(-1, count)
