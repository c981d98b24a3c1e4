"""The most probable exchange of light between cells, given residual pictures of them.

The residual pictures y of a channel, fitted to cells (`CameraCells.fitted_to_cells`), are linear in
the unknowns X and d:

    y = K l + d * l + noise,    K = W^T X W'

l is the light that each pattern sends from the projector's cells; d multiplies it cell by cell. W
and W' are Haar transforms of the camera's and the projector's cells. The entries of X and d are
independent, normally distributed variables of mean 0 with the variances V and V_d; the noise has
the variances R. With H for the linear map from the unknowns to y, and Sigma for the diagonal matrix
of V and V_d, their most probable values are

    (X, d) = Sigma H^T lambda,    (H Sigma H^T + R) lambda = y

The code computes ``Sigma H^T lambda`` as

    X = V * (r l_w^T)                  r = W lambda,  l_w = W' l
    X = V * (r l_w^T + l_w r^T)        coaxial rigs, where X is symmetric

where * multiplies entry by entry. For a diagonal entry the last line is twice what ``V H^T`` gives,
so that the prior variance of a diagonal entry is effectively 2 V on coaxial rigs.

The system for lambda has one unknown for each cell and picture. It is solved by conjugate
gradients; the preconditioner inverts the covariance of the pictures for small groups of wavelets.
`rfpipe.methods.residual.prior` learns V, which is 0 for most pairs of wavelets; X then has an entry
for each of the other pairs. On a coaxial rig K is symmetric; d, the light that a cell returns to
itself, is an unknown on coaxial rigs only.

==========  =================  ============  ===================================================
symbol      name in the code   shape         meaning and unit
==========  =================  ============  ===================================================
``K``       `matrix`           (M', N')      exchange between M' camera and N' projector cells
``X``       `core`             (m, n) or     coefficients of K: exchange between m and n wavelets
                               (pairs,)
``d``       `direct`           (M',)         light that a cell returns to itself
``W, W'``   `haar`,            (m, M'),      Haar transforms; orthonormal
            `sender_haar`      (n, N')
``l``       `cell_light`       (N', P)       light that P patterns send from each cell
``l_w``     `light`            (n, P)        ``W' l``, the same in wavelets
``y``       `observed`         (M', P)       residual pictures over f, radiance
``R``       `variance`         (M', P)       variance of their noise
``V``       `prior`            (m, n)        prior variances of the entries of X
``V_d``     `direct_variance`  scalar        prior variance of the entries of d
``lambda``  `dual`             (M', P)       dual solution
``r``       `received`         (m, P)        ``W lambda``, the same in wavelets
==========  =================  ============  ===================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from rfpipe.array_types import Float
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.methods.residual.cell_data import CellData, WaveletPairs

_ROUNDING = float(np.finfo(np.float32).eps)
# Residual of conjugate gradients, relative to the pictures.
_TOLERANCE = 1e-3


class Solution(NamedTuple):
    """The most probable X, as an `Exchange` represents it, and d, (M',)."""

    core: Float
    direct: Float


class Exchange(Protocol):
    """The prior variances V, for all pairs of wavelets or for some of them."""

    def empty_core(self) -> Float:
        """Allocate X."""

    def apply(self, received: Float, core: Float) -> Float:
        """Write ``X = V * (r l_w^T)`` to `core`, and return ``X l_w``; see the module."""


@dataclass(frozen=True)
class DenseExchange:
    """Prior variances of all pairs of wavelets, (m, n).

    Of a symmetric X, the lower half is written.
    """

    prior: Float
    light: Float
    is_symmetric: bool

    def empty_core(self) -> Float:
        """Allocate X, (m, n)."""
        return np.zeros_like(self.prior)

    def apply(self, received: Float, core: Float) -> Float:
        """Write X to `core`, and return ``X l_w``."""
        if not self.is_symmetric:
            np.matmul(received, self.light.T, out=core)
            np.multiply(core, self.prior, out=core)
            product: Float = core @ self.light
            return product
        from scipy.linalg.blas import ssymm, ssyr2k

        light, half = self.light.T, core.T  # in Fortran's order, for BLAS
        ssyr2k(1, received.T, light, c=half, trans=1, overwrite_c=1)
        np.multiply(core, self.prior, out=core)
        exchanged: Float = ssymm(1, half, light, side=1).T
        return exchanged


@dataclass(frozen=True)
class PairExchange:
    """Prior variances of the significant pairs of wavelets; X has one entry for each pair."""

    pairs: WaveletPairs
    light: Float
    is_symmetric: bool

    @classmethod
    def of(cls, data: CellData, prior: Float) -> PairExchange:
        """Take the pairs with a prior variance above 0; of a symmetric prior its upper half."""
        first, second = np.nonzero(np.triu(prior) if data.is_symmetric else prior)
        pairs = WaveletPairs(first.astype(np.int32), second.astype(np.int32), prior[first, second])
        return cls(pairs, data.light, data.is_symmetric)

    def empty_core(self) -> Float:
        """Allocate X, (pairs,)."""
        return np.zeros_like(self.pairs.variance)

    def apply(self, received: Float, core: Float) -> Float:
        """Write X to `core`, and return ``X l_w``."""
        from rfpipe.methods.residual.pair_kernels import exchange, exchange_symmetric

        product = np.zeros_like(received)
        kernel = exchange_symmetric if self.is_symmetric else exchange
        kernel(self.pairs, received, self.light, core, product)
        return product


@dataclass(frozen=True)
class Posterior:
    """The linear system of the most probable exchange, for one prior.

    Attributes
    ----------
    data : CellData
    exchange : Exchange
        V.
    variance_scale : numpy.float32
        Factor of the variances R.
    inverses : list of ndarray of float32, shape (places, P, P)
        Inverse covariance of the pictures of the wavelets of each place, scale by scale, as if
        their entries of X were independent of all others.
    """

    data: CellData
    exchange: Exchange
    variance_scale: np.float32
    inverses: list[Float]

    @classmethod
    def of(
        cls, data: CellData, prior: Float, exchange: Exchange, variance_scale: int = 1
    ) -> Posterior:
        """Prepare the preconditioner for a prior V, (m, n)."""
        noise = variance_scale * data.noise
        inverses = [
            np.stack(
                [
                    _inverse_covariance(data.light, prior[rows].mean(axis=0), noise)
                    for rows in places
                ]
            )
            for places in data.place_groups
        ]
        return cls(data, exchange, np.float32(variance_scale), inverses)

    def solve(self, observed: Float, iterations: int) -> Solution:
        """Compute the most probable X and d for pictures y (M', P), 0 where a cell is unknown."""
        data, direct_variance = self.data, self.data.direct_variance
        core = self.exchange.empty_core()  # written by each application of the covariance

        def covariance(dual: Float) -> Float:
            """Apply ``H Sigma H^T + R``; writes the X of `dual`."""
            pictures = data.haar.inverse(self.exchange.apply(data.haar.forward(dual), core))
            if data.is_symmetric:
                direct = direct_variance * np.einsum("cm,cm->c", dual, data.cell_light)
                pictures += direct[:, None] * data.cell_light
            pictures += self.variance_scale * data.variance * dual
            pictures *= data.known
            return pictures

        dual = conjugate_gradients(
            covariance,
            observed,
            self._precondition,
            None,
            _TOLERANCE,
            iterations,
            preconditioned_norm=False,
        )
        covariance(dual)
        if not data.is_symmetric:
            return Solution(core, np.zeros(len(observed), np.float32))
        return Solution(core, direct_variance * np.einsum("cm,cm->c", dual, data.cell_light))

    def _precondition(self, pictures: Float) -> Float:
        coefficients = self.data.haar.forward(pictures)
        for inverse, rows in zip(self.inverses, self.data.place_groups, strict=True):
            coefficients[rows] = coefficients[rows] @ inverse
        return self.data.haar.inverse(coefficients) * self.data.known


def _inverse_covariance(light: Float, prior: Float, noise: float) -> Float:
    """Invert ``l_w^T diag(V) l_w + noise``, (P, P), for the mean prior variances V, (n,)."""
    from scipy.linalg.lapack import dpotrf, dpotri

    scaled = light * np.sqrt(prior)[:, None]
    covariance = (scaled.T @ scaled).astype(np.float64)
    # float32 sums of much brighter light have larger rounding errors than the noise
    rounding = _ROUNDING * len(covariance) * float(covariance.diagonal().max())
    covariance[np.diag_indices(len(covariance))] += noise + rounding
    inverse = np.triu(dpotri(dpotrf(covariance)[0])[0])
    symmetric: Float = (inverse + np.triu(inverse, 1).T).astype(np.float32)
    return symmetric
