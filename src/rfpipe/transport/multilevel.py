"""Dual photography's transport: a sparse matrix (block, pixel) -> value a level (thesis §3.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.arrays import ArrayBundle
from rfpipe.transport.base import Float
from rfpipe.transport.lazy import LazySequence, names_by_prefix
from rfpipe.transport.level_transport import LevelTransport
from rfpipe.transport.responses import (
    RESPONSE_ARRAYS,
    Responses,
    Spread,
    by_level,
    fold,
    spread_by_transpose,
    spread_evenly,
)
from rfpipe.transport.rounding import rounded
from rfpipe.units import NumberFormat

# Patterns relit together: bounds the memory of the planes that are summed in float64.
_BATCH = 16


class MultilevelTransport(LevelTransport):
    """Transport as a sum over levels of sparse matrices (block, pixel) -> value.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.base.Transport`.
    content : sequence of Responses
        By level, the coarsest first; may be read when used.
    symmetric : bool
        Whether the transport is its own transpose, as a coaxial rig's is: a response is then spread
        over its block in proportion to the transpose's estimate, else evenly.
    """

    kind = "multilevel"
    stored_names = ("camera_shape", "projector_shape", "symmetric")
    _content: Sequence[Responses]

    def __init__(self, *args: Any, symmetric: bool = False, **named: Any) -> None:
        super().__init__(*args, **named)
        self.symmetric = symmetric
        self._spreads: dict[int, Spread] = {}

    def evenly(self) -> MultilevelTransport:
        """Return the transport whose responses are spread evenly over their blocks."""
        shapes = self.camera_shape, self.projector_shape
        return type(self)(*shapes, self.channels, self.level_rows, self._content)

    @property
    def level_responses(self) -> Sequence[Responses]:
        """The pairs by level, the coarsest first."""
        return self._content

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``, by eq. (3.2).

        Each level's matrix acts on the pattern's means over the level's blocks, weighted ones
        where the transport is symmetric.
        """
        from rfpipe.transport.pair_kernels import scatter_to_pixels

        pixels = int(np.prod(self.camera_shape))
        result = np.empty((*patterns.shape[:2], pixels), np.float32)
        for first in range(0, len(patterns), _BATCH):
            part = patterns[first : first + _BATCH][..., self.tree.order]
            images = np.zeros((*part.shape[:2], pixels))
            for pairs, spread, values in self._chosen(channels):
                means = np.stack(
                    [shares @ part[:, k].T for k, shares in enumerate(spread.of(channels))]
                )
                weights = np.ascontiguousarray(np.moveaxis(means, 2, 0))
                scatter_to_pixels(spread.node, pairs.pixel, values, weights, images)
            result[first : first + _BATCH] = images
        return result

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``: `forward` transposed.

        Each level's values are spread over their blocks.
        """
        from rfpipe.transport.pair_kernels import gather_to_blocks

        rays = self.tree.domain.size
        result = np.empty((*images.shape[:2], rays), np.float32)
        for first in range(0, len(images), _BATCH):
            part = images[first : first + _BATCH]
            spread = np.zeros((*part.shape[:2], rays))
            light = np.ascontiguousarray(part)
            for pairs, over, values in self._chosen(channels):
                chosen = over.of(channels)
                totals = np.zeros((*part.shape[:2], chosen[0].shape[0]))
                gather_to_blocks(over.node, pairs.pixel, values, light, totals)
                for k, shares in enumerate(chosen):
                    spread[:, k] += (shares.T @ totals[:, k].T).T
            result[first : first + _BATCH] = spread[..., self.tree.inverse]
        return result

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return what each ray sees under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        from scipy.sparse import csr_array

        seen = np.zeros(patterns.shape[0])
        for pairs, spread in self.spread_pairs():
            light = patterns[:, self.tree.order] @ spread.of([channel])[0].T
            where = pairs.pixel, spread.node
            seen += (csr_array((pairs.values[channel], where), shape=light.shape) * light).sum(1)
        return seen.astype(np.float32)

    def spread_pairs(self) -> Iterator[tuple[Responses, Spread]]:
        """Yield each level's pairs, and how their responses are spread over their blocks."""
        for index, pairs in enumerate(self.level_responses):
            yield pairs, self._spread(index, pairs)

    def _spread(self, index: int, pairs: Responses) -> Spread:
        """Return how a level's responses are spread over their blocks, made when first used."""
        if pairs.level not in self._spreads:
            self._spreads[pairs.level] = (
                spread_by_transpose(self.tree, self.level_responses, index)
                if self.symmetric and pairs.level < self.last_level
                else spread_evenly(self.tree, pairs)
            )
        return self._spreads[pairs.level]

    def _chosen(self, channels: Sequence[int]) -> Iterator[tuple[Responses, Spread, Float]]:
        """Yield each level's pairs, how they are spread, and the values of some channels."""
        chosen = list(channels)
        every = chosen == list(range(self.channels))
        for pairs, spread in self.spread_pairs():
            yield pairs, spread, pairs.values if every else pairs.values[chosen]

    def _truncated(self, level: int) -> list[Responses]:
        """Give what was subdivided at `level` of the blocks the sum of what was stored below it."""
        kept = [pairs for pairs in self.level_responses if pairs.level < level]
        folded = [pairs for pairs in self.level_responses if pairs.level >= level]
        pixels = int(np.prod(self.camera_shape))
        return by_level([*kept, fold(self.tree, level, folded, self.channels, pixels)])

    def _to_arrays(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        arrays: dict[str, NDArray[Any]] = {}
        for pairs in self.level_responses:
            parts = pairs.block, pairs.pixel, rounded(pairs.values, number_format)
            for part, array in zip(RESPONSE_ARRAYS, parts, strict=True):
                arrays[f"level_{pairs.level:02d}_{part}"] = array
        return arrays

    @classmethod
    def _open(cls, bundle: ArrayBundle, keep: bool) -> Sequence[Responses]:
        prefixes = names_by_prefix(bundle, RESPONSE_ARRAYS)

        def read(prefix: str) -> Responses:
            arrays = (bundle.read(f"{prefix}_{part}") for part in RESPONSE_ARRAYS)
            return Responses(int(prefix.split("_")[1]), *arrays)

        return LazySequence(list(prefixes), read, keep=keep)
