"""Schedules: the patterns of one level (thesis §3.1, §5.1)."""

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

    Either a partition, in which each ray is lit by at most one pattern, a union of blocks as in the
    thesis; or images of weights.

    Parameters
    ----------
    seed : int
        Simulated rigs draw the noise of pattern i by the key (seed, i), so that a repeated
        acquisition has the same noise. Each level of an acquisition has another seed, or its
        pictures would repeat the noise of another level.
    shape : tuple of int
        The projector's ray domain.
    count : int
        Number of patterns, at least 1.
    pattern_of_ray : ndarray of int32, shape `shape`, optional
        Index of the pattern that lights each ray, -1 for none.
    weights : ndarray of float32, shape (count, *shape), optional
        Patterns with weights in [0, 1], instead of `pattern_of_ray`. Booleans and the integers 0
        and 1 become float32; larger integers, as in a picture file, are rejected.
    complete : bool
        True if the level lights each ray that sends light to the camera exactly once, so that its
        images add up to the floodlit image (thesis B.2).
    """

    seed: int
    shape: tuple[int, ...]
    count: int
    pattern_of_ray: NDArray[np.int32] | None = None
    weights: NDArray[np.float32] | None = None
    complete: bool = False

    def __post_init__(self) -> None:
        if (self.pattern_of_ray is None) == (self.weights is None):
            raise InputError("a schedule has either pattern_of_ray or weights; give exactly one")
        patterns = self.pattern_of_ray if self.weights is None else self.weights
        expected = self.shape if self.weights is None else (self.count, *self.shape)
        assert patterns is not None
        if patterns.shape != tuple(expected):
            raise InputError(
                f"a schedule over {self.shape} needs an array {expected}, got {patterns.shape}"
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
        """Return the schedule that lights each block in the pattern of its number, -1 for none."""
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
        """Digest of the patterns, and of the seed of their noise."""
        patterns = self.pattern_of_ray if self.weights is None else self.weights
        return fingerprint([self.seed, list(self.shape), self.count, patterns])
