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
V first falls with the squared distance of two places and is then learned from the solution and its
uncertainty (empirical Bayes). On a coaxial rig K is symmetric; d, the light that a cell returns to
itself, is an unknown on coaxial rigs only.

==========  =================  ============  ===================================================
symbol      name in the code   shape         meaning and unit
==========  =================  ============  ===================================================
``K``       `matrix`           (M', N')      exchange between M' camera and N' projector cells
``X``       `core`             (m, n)        coefficients of K: exchange between m and n wavelets
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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.transport.wavelet import Group, Haar

_ROUNDING = float(np.finfo(np.float32).eps)
_TINY = float(np.finfo(np.float32).tiny)

# Share of the variance of residual pictures that light returned to its own cell may explain.
_DIRECT_SHARE = 0.02
# Distance, in cells, at which the prior variance has fallen to half.
_HALF_DISTANCE = 0.5
# Least share of the prior variance that remains after a fit, and least prior variance relative to
# the largest; both keep the system well-conditioned.
_LEAST_UNCERTAINTY, _LEAST_VARIANCE = 1e-4, 1e-10
# Residual of conjugate gradients, relative to the pictures.
_TOLERANCE = 1e-3


@dataclass(frozen=True)
class CellData:
    """Residual pictures of one channel, in cells.

    Attributes
    ----------
    haar, sender_haar : Haar
        Of the camera's and of the projector's cells.
    places : ndarray of float32, shape (N', 2), optional
        Row and column, in the camera's cells, of the spot that each projector cell lights. None for
        coaxial rigs, whose K is symmetric.
    cell_light : ndarray of float32, shape (N', P)
    light : ndarray of float32, shape (n, P)
    known : ndarray of bool, shape (M', P)
        Cells with a known pixel.
    observed, variance : ndarray of float32, shape (M', P)
        0 where a cell is unknown.
    """

    haar: Haar
    sender_haar: Haar
    places: Float | None
    cell_light: Float
    light: Float
    known: NDArray[np.bool_]
    observed: Float
    variance: Float

    @property
    def is_symmetric(self) -> bool:
        """True on a coaxial rig."""
        return self.places is None

    @cached_property
    def noise(self) -> float:
        """Harmonic mean of the variances of the noise."""
        certainty = np.divide(1, self.variance, where=self.known, out=np.zeros_like(self.observed))
        return 1 / max(float(certainty.mean(dtype=np.float64)), _TINY)

    @cached_property
    def direct_variance(self) -> np.float32:
        """V_d, the prior variance of the light that a cell returns to itself."""
        power = max(float(np.square(self.cell_light, dtype=np.float64).mean()), _TINY)
        return np.float32(_DIRECT_SHARE * self.observed.var(dtype=np.float64) / power)

    @cached_property
    def place_groups(self) -> list[NDArray[np.int64]]:
        """Numbers of the camera's wavelets, grouped by place, for the preconditioner."""
        return [rows for group in self.haar.groups for rows in group.by_place()]

    def matrix(self, core: Float) -> Float:
        """Compute K from X."""
        half = self.haar.inverse(core)
        transposed = self.sender_haar.inverse(np.ascontiguousarray(half.T))
        return transposed if self.is_symmetric else np.ascontiguousarray(transposed.T)

    def residual(self, matrix: Float, direct: Float) -> Float:
        """Subtract the pictures predicted by K and d from y; 0 where a cell is unknown."""
        predicted = matrix @ self.cell_light
        if self.is_symmetric:
            predicted += direct[:, None] * self.cell_light
        residual: Float = np.where(self.known, self.observed - predicted, 0)
        return residual

    def scale_pairs(self) -> Iterator[tuple[Group, Group]]:
        """Yield each pair of scales of the camera and the projector; once where K is symmetric."""
        for index, group in enumerate(self.haar.groups):
            for sender_group in self.sender_haar.groups[index if self.is_symmetric else 0 :]:
                yield group, sender_group

    def distances(self, group: Group, sender_group: Group) -> Float:
        """Compute the distances of the places of two scales in cells, across views too."""
        centres = sender_group.centres()
        if self.places is not None:
            _, height, width = self.sender_haar.stack
            cell = np.minimum(centres.astype(np.int64), (height - 1, width - 1))
            views, rows, columns = sender_group.grid
            view = np.repeat(np.arange(views), rows * columns)
            centres = self.places[(view * height + cell[:, 0]) * width + cell[:, 1]]
        offset = group.centres()[:, None] - centres
        distance: Float = np.hypot(offset[..., 0], offset[..., 1])
        return distance


def cell_data(
    haar: Haar,
    cell_light: Float,
    observed: Float,
    variance: Float,
    sender: tuple[Haar, Float] | None = None,
) -> CellData:
    """Prepare residual pictures.

    Parameters
    ----------
    haar : Haar
        Of the camera's cells.
    cell_light : ndarray of float32, shape (N', P)
        Sums over the projector's cells of the patterns times the projector's factor.
    observed, variance : ndarray of float32, shape (M', P)
        The variance is infinite where a cell has no known pixel.
    sender : tuple of Haar and ndarray, optional
        Of the projector's cells, and their places, see `CellData`. None for coaxial rigs.
    """
    known = np.isfinite(variance)
    sender_haar, places = (haar, None) if sender is None else sender
    cell_light = np.ascontiguousarray(cell_light)
    return CellData(
        haar,
        sender_haar,
        places,
        cell_light,
        sender_haar.forward(cell_light),
        known,
        np.where(known, observed, 0),
        np.where(known, variance, 0),
    )


def initial_prior(data: CellData) -> Float:
    """Compute V before any fit: it falls with the squared distance of two places.

    Its sum is such that the prior explains the energy of the residual pictures.
    """
    changing = data.light - data.light.mean(axis=1, keepdims=True)
    power = np.square(changing, dtype=np.float64).sum(axis=0).mean() / len(changing)
    energy = np.square(data.observed, dtype=np.float64).sum(axis=0).mean()
    prior = np.empty((data.haar.size, data.sender_haar.size), np.float32)
    for group, sender_group in data.scale_pairs():
        falloff = 1 + np.square(data.distances(group, sender_group) / _HALF_DISTANCE)
        pairs = (group.side * sender_group.side) ** 2 / falloff
        _write_pairs(prior, data, (group, sender_group), pairs.astype(np.float32))
    total = float(energy / max(power, _TINY))
    prior *= np.float32(total / prior.sum(dtype=np.float64))
    return prior


def _write_pairs(prior: Float, data: CellData, groups: tuple[Group, Group], pairs: Float) -> None:
    """Write variances of pairs of places (places, sender's places) to all orientations."""
    group, sender_group = groups
    is_diagonal = data.is_symmetric and group is sender_group
    if is_diagonal:
        pairs = np.float32(0.5) * (pairs + pairs.T)
    shape = (group.orientations, group.places, sender_group.orientations, sender_group.places)
    block = np.broadcast_to(pairs[None, :, None], shape).reshape(
        group.orientations * group.places, sender_group.orientations * sender_group.places
    )
    prior[group.rows, sender_group.rows] = block
    if data.is_symmetric and not is_diagonal:
        prior[sender_group.rows, group.rows] = block.T


class Solution(NamedTuple):
    """The most probable X, (m, n), and d, (M',)."""

    core: Float
    direct: Float


@dataclass(frozen=True)
class Posterior:
    """The linear system of the most probable exchange, for one prior.

    Attributes
    ----------
    data : CellData
    prior : ndarray of float32, shape (m, n)
        V.
    variance_scale : numpy.float32
        Factor of the variances R.
    roots, inverses : ndarray of float32, shape (place groups, P, P)
        Inverse Cholesky factors, and inverses, of the covariance of the pictures of each group of
        wavelets, as if their entries of X were independent of all others.
    """

    data: CellData
    prior: Float
    variance_scale: np.float32
    roots: Float
    inverses: Float

    @classmethod
    def of(cls, data: CellData, prior: Float, variance_scale: int = 1) -> Posterior:
        """Prepare the preconditioner for a prior."""
        count, groups = data.light.shape[1], data.place_groups
        roots = np.empty((len(groups), count, count), np.float32)
        inverses = np.empty_like(roots)
        for index, rows in enumerate(groups):
            scaled = data.light * np.sqrt(prior[rows].mean(axis=0))[:, None]
            covariance = (scaled.T @ scaled).astype(np.float64)
            # float32 sums of much brighter light have larger rounding errors than the noise
            rounding = _ROUNDING * count * float(covariance.diagonal().max())
            covariance[np.diag_indices(count)] += variance_scale * data.noise + rounding
            root = np.linalg.inv(np.linalg.cholesky(covariance)).astype(np.float32)
            roots[index], inverses[index] = root, root.T @ root
        return cls(data, prior, np.float32(variance_scale), roots, inverses)

    def solve(self, observed: Float, iterations: int) -> Solution:
        """Compute the most probable X and d for pictures y (M', P), 0 where a cell is unknown."""
        data, direct_variance = self.data, self.data.direct_variance
        core = np.zeros_like(self.prior)  # written by each application of the covariance

        def covariance(dual: Float) -> Float:
            """Apply ``H Sigma H^T + R``; writes the X of `dual`, of a symmetric one half."""
            received = data.haar.forward(dual)
            if data.is_symmetric:
                pictures = data.haar.inverse(self._exchange(received, core))
                direct = direct_variance * np.einsum("cm,cm->c", dual, data.cell_light)
                pictures += direct[:, None] * data.cell_light
            else:
                np.matmul(received, data.light.T, out=core)
                np.multiply(core, self.prior, out=core)
                pictures = data.haar.inverse(core @ data.light)
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
        direct = direct_variance * np.einsum("cm,cm->c", dual, data.cell_light)
        symmetric = core + core.T
        symmetric[np.diag_indices(len(symmetric))] /= 2
        return Solution(symmetric, direct)

    def _exchange(self, received: Float, core: Float) -> Float:
        """Compute ``X l_w`` with ``X = V * (r l_w^T + l_w r^T)``.

        One half of the symmetric X, with the diagonal, is written to `core`.
        """
        from scipy.linalg.blas import ssymm, ssyr2k

        light, half = self.data.light.T, core.T  # in Fortran's order, for BLAS
        ssyr2k(1, received.T, light, c=half, trans=1, overwrite_c=1)
        np.multiply(core, self.prior, out=core)
        exchanged: Float = ssymm(1, half, light, side=1).T
        return exchanged

    def _precondition(self, pictures: Float) -> Float:
        coefficients = self.data.haar.forward(pictures)
        for inverse, rows in zip(self.inverses, self.data.place_groups, strict=True):
            coefficients[rows] = coefficients[rows] @ inverse
        return self.data.haar.inverse(coefficients) * self.data.known


def learned_prior(posterior: Posterior, core: Float) -> Float:
    """Estimate V from a solution X and its uncertainty.

    The expected squares of the entries are averaged over the orientations and the neighbours of a
    pair of places, and drawn towards the mean of all pairs of the same two scales at about the same
    distance, each half octave of it.
    """
    from scipy.ndimage import uniform_filter

    data, energy = posterior.data, np.square(core) + _remaining_variance(posterior)
    variance = np.empty_like(energy)
    for group, sender_group in data.scale_pairs():
        pairs = (
            energy[group.rows, sender_group.rows]
            .reshape(
                group.orientations, group.places, sender_group.orientations, sender_group.places
            )
            .mean(axis=(0, 2))
        )
        grid = (*group.grid, *sender_group.grid)
        smooth = uniform_filter(pairs.reshape(grid), size=(1, 3, 3, 1, 3, 3), mode="nearest")
        pairs = (pairs + smooth.reshape(pairs.shape)) / 2
        distances = data.distances(group, sender_group)
        half_octave: NDArray[np.int64] = (2 * np.log2(1 + distances)).astype(int)
        count = np.maximum(np.bincount(half_octave.ravel()), 1)
        typical = np.bincount(half_octave.ravel(), pairs.ravel()) / count
        entries = group.orientations * sender_group.orientations
        drawn = (entries * pairs + typical[half_octave]) / (entries + 1)
        _write_pairs(variance, data, (group, sender_group), drawn.astype(np.float32))
    floored: Float = np.maximum(variance, np.float32(_LEAST_VARIANCE) * variance.max())
    return floored


def _remaining_variance(posterior: Posterior) -> Float:
    """Approximate the variance of each entry of X that the pictures leave, (m, n).

    Each group of wavelets is taken as independent of the others. On coaxial rigs an entry is
    measured by its row and by its column; their certainties add up.
    """
    data, prior = posterior.data, posterior.prior
    explained = np.empty_like(prior)
    for root, rows in zip(posterior.roots, data.place_groups, strict=True):
        explained[rows] = np.square(root @ data.light.T).sum(axis=0)
    share = np.maximum(1 - prior * explained, np.float32(_LEAST_UNCERTAINTY))
    certainty = 1 / (prior * share)
    if data.is_symmetric:
        before = 1 / prior
        certainty = np.maximum(certainty + certainty.T - before, before)
    remaining: Float = 1 / certainty
    return remaining
