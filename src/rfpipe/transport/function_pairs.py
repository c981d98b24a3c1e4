"""Symmetric transport between smooth functions over the rays.

One channel is

    T = F B S B^T F

=======  ===============  ===============  ======================================================
symbol   name             shape            meaning
=======  ===============  ===============  ======================================================
``F``    ``factor``       (N,) float32     diagonal: light that a ray takes and gives
``B``    `functions`      (N, n) sparse    values of n functions at the rays
``S``    ``cores``        (pairs,)         symmetric, sparse; a core is the entry of a pair of
         ``pairs``        (2, pairs)       functions, the exchange of light between them
=======  ===============  ===============  ======================================================
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from rfpipe.array_types import Float
from rfpipe.transport.array_transport import ArrayTransport, CoaxialTransport

_RAYS_PER_BATCH = 64


class FunctionPairTransport(CoaxialTransport, ArrayTransport):
    """Symmetric transport ``T = F B S B^T F`` per channel; see the module for its symbols.

    The arrays ``factor`` and ``cores`` have the channel as their first axis.
    """

    @abstractmethod
    def functions(self) -> Any:
        """Return B, sparse (N, functions)."""

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return each ray under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        from scipy.sparse import csr_array

        factor, cores = (self._content[name][channel] for name in ("factor", "cores"))
        functions, (first, second) = self.functions(), self._content["pairs"]
        half = csr_array((cores / (1 + (first == second)), (first, second)),
                         shape=2 * functions.shape[1:])  # fmt: skip
        light = patterns.multiply(factor) @ functions
        image: Float = factor * product_diagonal(functions, half + half.T, light)
        return image


def product_diagonal(outer: Any, middle: Any, inner: Any) -> Float:
    """Return the diagonal of ``outer middle inner^T`` of sparse matrices, float32 (rays,)."""
    diagonal = np.empty(outer.shape[0], np.float32)
    # neighbouring rays have few functions between them
    for first in range(0, len(diagonal), _RAYS_PER_BATCH):
        batch = slice(first, first + _RAYS_PER_BATCH)
        rows, columns = (np.unique(matrix[batch].indices) for matrix in (outer, inner))
        between = middle[rows][:, columns].toarray()
        parts = outer[batch][:, rows] @ between, inner[batch][:, columns].toarray()
        diagonal[batch] = (parts[0] * parts[1]).sum(axis=1)
    return diagonal
