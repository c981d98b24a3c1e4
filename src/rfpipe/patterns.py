"""Schedules: which patterns a level shows (thesis §3.1, §5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.weights import as_weights


@dataclass(frozen=True)
class Schedule:
    """The patterns of one level.

    Either a partition, where each ray is lit by at most one pattern (unions of blocks, as in
    the thesis), or explicit weight images.

    Parameters
    ----------
    seed : int
        First number of the keys under which rigs take the pictures, by which simulated noise is
        drawn; another one for each level of an acquisition.
    shape : tuple of int
        The projector's ray domain.
    count : int
        Number of patterns, at least 1.
    pattern_of_ray : ndarray of int32, shape `shape`, optional
        Index of the pattern that lights each ray, -1 for none.
    weights : ndarray of float32, shape (count, *shape), optional
        Explicit patterns with weights in [0, 1]; excludes `pattern_of_ray`. Booleans, and whole
        numbers 0 and 1, become float32; a picture's 0 to 255 are refused.
    complete : bool
        Whether every ray that can send light to the camera is lit exactly once by the level,
        so that its images add up to the floodlit image (the premise of thesis B.2).
    """

    seed: int
    shape: tuple[int, ...]
    count: int
    pattern_of_ray: NDArray[np.int32] | None = None
    weights: NDArray[np.float32] | None = None
    complete: bool = False

    def __post_init__(self) -> None:
        if (self.pattern_of_ray is None) == (self.weights is None):
            raise InputError("a schedule holds either pattern_of_ray or weights, exactly one")
        given = self.pattern_of_ray if self.weights is None else self.weights
        expected = self.shape if self.weights is None else (self.count, *self.shape)
        assert given is not None
        if given.shape != tuple(expected):
            raise InputError(
                f"a schedule over {self.shape} needs an array {expected}, got {given.shape}"
            )
        if self.weights is not None:
            weights = as_weights(self.weights, "a pattern of a schedule")
            object.__setattr__(self, "weights", weights)

    @classmethod
    def floodlit(cls, shape: tuple[int, ...]) -> Schedule:
        """Return level 0: one pattern, all on."""
        return cls(0, tuple(shape), 1, pattern_of_ray=np.zeros(shape, np.int32), complete=True)

    @classmethod
    def of_blocks(
        cls, tree: BlockTree, level: int, pattern_of_block: NDArray[np.int32], complete: bool
    ) -> Schedule:
        """Return the schedule that lights each block of a level in its pattern (-1: in none)."""
        count = int(pattern_of_block.max(initial=-1)) + 1
        return cls(
            level,
            tree.domain.shape,
            count,
            pattern_of_ray=pattern_of_block[tree.labels(level)].astype(np.int32),
            complete=complete,
        )

    def batch(self, first: int, last: int) -> NDArray[np.float32]:
        """Return patterns ``first:last`` as images, float32 ``(last - first, *shape)``."""
        if self.weights is not None:
            return self.weights[first:last]
        assert self.pattern_of_ray is not None
        index = np.arange(first, min(last, self.count)).reshape(-1, *(1,) * len(self.shape))
        lit: NDArray[np.float32] = (self.pattern_of_ray[None] == index).astype(np.float32)
        return lit

    def pattern_of_block(self, tree: BlockTree, level: int) -> NDArray[np.int32]:
        """Return the pattern that lights each block of a level of the tree, -1 for none."""
        assert self.pattern_of_ray is not None
        first_ray = tree.order[tree.starts[level][:-1]]
        return self.pattern_of_ray.ravel()[first_ray]

    def digest(self) -> str:
        """Fingerprint of the patterns, and of the seed of their noise."""
        shown = self.pattern_of_ray if self.weights is None else self.weights
        return fingerprint([self.seed, list(self.shape), self.count, shown])
