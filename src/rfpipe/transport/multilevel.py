"""Transport of dual photography: a sum of sparse matrices, one per level (thesis §3.2).

The matrix of a level has the responses of camera pixels to the blocks of that level, so that

    c = sum over levels of R_level B_level p   [eq. 3.2]

where row k of B has the shares of the rays in block k. An entry of the transport is stored at one
level only, the finest at which it was measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.store.arrays import ArrayBundle
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

# Patterns that are relit at a time: bounds the memory of the planes that are summed in float64.
_PATTERNS_PER_BATCH = 16


class MultilevelTransport(LevelTransport):
    """Transport as a sum over levels of sparse matrices (block, pixel) -> value.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.base.Transport`.
    content : sequence of Responses
        By level, the coarsest first; in memory or read when used.
    symmetric : bool
        Whether the transport is symmetric, as on a coaxial rig: a response is then distributed
        over its block in proportion to the responses of the transpose, else evenly.
    """

    kind = "multilevel"
    stored_names = ("camera_shape", "projector_shape", "symmetric")
    _content: Sequence[Responses]

    def __init__(self, *args: Any, symmetric: bool = False, **named: Any) -> None:
        super().__init__(*args, **named)
        self.symmetric = symmetric
        self._spreads: dict[int, Spread] = {}

    def evenly(self) -> MultilevelTransport:
        """Return a transport whose responses are distributed evenly over their blocks."""
        shapes = self.camera_shape, self.projector_shape
        return type(self)(*shapes, self.channels, self.level_rows, self._content)

    @property
    def level_responses(self) -> Sequence[Responses]:
        """The responses by level, the coarsest first."""
        return self._content

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``, by eq. (3.2).

        The matrix of a level multiplies the means of the pattern over the blocks of the level,
        which are weighted means where the transport is symmetric.
        """
        from rfpipe.transport.response_kernels import scatter_to_pixels

        pixels = int(np.prod(self.camera_shape))
        result = np.empty((*patterns.shape[:2], pixels), np.float32)
        for first in range(0, len(patterns), _PATTERNS_PER_BATCH):
            part = patterns[first : first + _PATTERNS_PER_BATCH][..., self.tree.order]
            images = np.zeros((*part.shape[:2], pixels))
            for responses, spread, values in self._chosen(channels):
                means = np.stack(
                    [shares @ part[:, k].T for k, shares in enumerate(spread.of(channels))]
                )
                weights = np.ascontiguousarray(np.moveaxis(means, 2, 0))
                scatter_to_pixels(spread.node, responses.pixel, values, weights, images)
            result[first : first + _PATTERNS_PER_BATCH] = images
        return result

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``, the transpose of `forward`."""
        from rfpipe.transport.response_kernels import gather_to_blocks

        rays = self.tree.domain.size
        result = np.empty((*images.shape[:2], rays), np.float32)
        for first in range(0, len(images), _PATTERNS_PER_BATCH):
            part = images[first : first + _PATTERNS_PER_BATCH]
            spread = np.zeros((*part.shape[:2], rays))
            light = np.ascontiguousarray(part)
            for responses, over, values in self._chosen(channels):
                chosen = over.of(channels)
                totals = np.zeros((*part.shape[:2], chosen[0].shape[0]))
                gather_to_blocks(over.node, responses.pixel, values, light, totals)
                for k, shares in enumerate(chosen):
                    spread[:, k] += (shares.T @ totals[:, k].T).T
            result[first : first + _PATTERNS_PER_BATCH] = spread[..., self.tree.inverse]
        return result

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return each ray under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        from scipy.sparse import csr_array

        image = np.zeros(patterns.shape[0])
        for responses, spread in self.spread_responses():
            light = patterns[:, self.tree.order] @ spread.of([channel])[0].T
            index = responses.pixel, spread.node
            image += (csr_array((responses.values[channel], index), shape=light.shape) * light).sum(
                1
            )
        return image.astype(np.float32)

    def spread_responses(self) -> Iterator[tuple[Responses, Spread]]:
        """Yield the responses of each level, and their shares of rays."""
        for index, responses in enumerate(self.level_responses):
            yield responses, self._spread(index, responses)

    def _spread(self, index: int, responses: Responses) -> Spread:
        """Return the shares of rays in the responses of a level, computed when first used."""
        if responses.level not in self._spreads:
            self._spreads[responses.level] = (
                spread_by_transpose(self.tree, self.level_responses, index)
                if self.symmetric and responses.level < self.last_level
                else spread_evenly(self.tree, responses)
            )
        return self._spreads[responses.level]

    def _chosen(self, channels: Sequence[int]) -> Iterator[tuple[Responses, Spread, Float]]:
        """Yield the responses of each level, their shares, and the values of some channels."""
        chosen = list(channels)
        all_channels = chosen == list(range(self.channels))
        for responses, spread in self.spread_responses():
            yield responses, spread, responses.values if all_channels else responses.values[chosen]

    def _truncated(self, level: int) -> list[Responses]:
        """Replace the responses of `level` and of finer levels by their sums over its blocks."""
        coarser = [responses for responses in self.level_responses if responses.level < level]
        finer = [responses for responses in self.level_responses if responses.level >= level]
        pixels = int(np.prod(self.camera_shape))
        return by_level([*coarser, fold(self.tree, level, finer, self.channels, pixels)])

    def _to_arrays(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        arrays: dict[str, NDArray[Any]] = {}
        for responses in self.level_responses:
            parts = responses.block, responses.pixel, rounded(responses.values, number_format)
            for part, array in zip(RESPONSE_ARRAYS, parts, strict=True):
                arrays[f"level_{responses.level:02d}_{part}"] = array
        return arrays

    @classmethod
    def _open(cls, bundle: ArrayBundle, keep: bool) -> Sequence[Responses]:
        prefixes = names_by_prefix(bundle, RESPONSE_ARRAYS)

        def read(prefix: str) -> Responses:
            arrays = (bundle.read(f"{prefix}_{part}") for part in RESPONSE_ARRAYS)
            return Responses(int(prefix.split("_")[1]), *arrays)

        return LazySequence(list(prefixes), read, keep=keep)
