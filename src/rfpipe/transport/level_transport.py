"""Base class of transports that are a sum over the levels of a block tree."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.transport.base import Transport


class LevelTransport(Transport):
    """Transport made of sets of arrays, each for the blocks of one level.

    The sets stay in memory where all of them fit, or are read at each use. The acquisition
    and the block tree have the same levels.
    """

    _content: Sequence[Any]

    @cached_property
    def tree(self) -> BlockTree:
        """The block tree of the projector's rays."""
        return BlockTree(RayDomain(self.projector_shape))

    @property
    def last_level(self) -> int:
        """The level of single rays."""
        return self.tree.n_levels - 1

    @property
    def known_levels(self) -> range:
        """All levels: the sets of finer levels add up to the measurements of a level."""
        return range(self.last_level + 1)

    def truncate(self, level: int) -> Transport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7)."""
        super().truncate(level)  # rejects unknown levels
        if level == self.last_level:
            return self
        rows = [row for row in self.level_rows if row["level"] <= level]
        return self.with_content(rows, self._truncated(level))

    @abstractmethod
    def _truncated(self, level: int) -> Sequence[Any]:
        """Return the sets of the transport as it is known at a level."""

    def _bytes_in_memory(self) -> int:
        return sum(arrays.nbytes for arrays in self._content)
