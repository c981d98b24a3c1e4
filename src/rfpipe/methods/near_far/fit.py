"""Fit of the near/far model's indirect light, by regularised least squares.

With ``T = diag(d) + F B S B^T F`` (`rfpipe.methods.near_far.model`), the floodlit image ``F = T 1``
fixes the direct light d, so that the picture c of a pattern p depends on S alone. Divided by F,

    y_ip = (c_ip - F_i p_i) / F_i = a_ip                 where pattern p leaves pixel i dark
                                  = a_ip - a_i,full      where it lights pixel i

    a = B S L,    L = B^T F [p_1 ... p_P, 1]

``a_i,full`` is the indirect light under full light: the last column of a, for the pattern 1. On
dark pixels y is the indirect light itself, without the noise of the direct light. The cores S
minimise

    sum_ip w_ip (y_ip - prediction_ip)^2 + sum_k (S_k / sigma_k)^2

with ``w_ip = F_i^2 / var(c_ip - F_i p_i)``, where the variance includes an error of the model of
0.2 % of F. The prior deviations sigma first fall with the squared distance of the functions and are
then learned from the fit. Since B is constant over cells of pixels
(`rfpipe.methods.near_far.pictures`), the lit pixels of a cell count as one pixel, and so do its
dark pixels: c and F are summed over them. Cells are summed over patches where all functions are
coarse.

=========  ==================  ============  =======================================================
symbol     name in the code    shape         meaning and unit
=========  ==================  ============  =======================================================
``F p``    `light`             (P, M')       floodlit image of the lit pixels of M' cells, of P
                                             pictures without the floodlit one, radiance
``F``      `factor`            (M',)         floodlit image summed over cells, radiance
``w``      `dark_weight`,      (P, M')       weights of the dark and of the lit pixels of each cell
           `lit_weight`                      in each picture, no unit
``w y``    `dark_data`,        (P, M')       weighted data, no unit
           `lit_data`
``B``      `Patches.values`    (patches, n)  mean of each of n functions over each patch
``L``      `light`             (n, P + 1)    light of each pattern on each function, radiance; the
                                             last column is of full light
``a``                          (M', P + 1)   indirect light over F, no unit
``S``      `cores`             (pairs,)      an entry for each pair of functions, inverse radiance
``sigma``  `deviations`        (pairs,)      prior standard deviation of each core
=========  ==================  ============  =======================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Float, FunctionTable, Numbers
from rfpipe.blocks import RayDomain
from rfpipe.methods.images import Pictures, beyond_noise
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.methods.near_far.model import SmoothModel
from rfpipe.methods.near_far.pictures import SplitPictures
from rfpipe.methods.residual.prior import threshold_below
from rfpipe.methods.smooth_light import coarse_to_fine, learned_deviations, prior_areas
from rfpipe.steps import step
from rfpipe.transport.multiscale import MultiscaleBasis, exchanged
from rfpipe.transport.multiscale import cells as scale_cells
from rfpipe.transport.wavelet import Cells

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Errors on dark pixels as fractions of the floodlit image: finer functions are added where the
# error exceeds the first; the second is the assumed error of the model. A basis finer than the
# pictures can resolve increases errors. On scenes with one, two and three creases the best values
# lay between half and twice these, with little difference.
_REFINED_AT = 0.005
_MODEL_ERROR = 0.002
# Largest number of pairs of functions; to find them takes 1 GB of memory.
_MOST_PAIRS = 2**24
# Cores that together have at most this share of the expected light of the pictures are not fitted.
# At 96 x 108 these are a third of all cores; five times the share increases errors by 1 %.
_INSIGNIFICANT = 2e-4
# Values of a cache line. Products with rows of 64 values took 16 % less time than with 50.
_CACHE_LINE = 16
# Tolerance and largest number of iterations of conjugate gradients. Twice the tolerance of the
# first fit, from which deviations are learned, or of the final one increases errors by 3 to 4 %.
# Large images reach the number of iterations first. On wedge IV at 310 x 350, 50 iterations of the
# first and 100 of the final fit increase errors by 7 %; 120 and 300 reduce them by 1 %, and
# increase them by 2 % in a room of 96 x 108, where noise limits them. There, 15 iterations for a
# channel in place of 30 change errors by .4 %, 10 increase them by 1 %.
_COARSE, _FIRST, _FINAL, _CHANNEL = (3e-3, 60), (1e-3, 80), (1.5e-4, 150), (1e-3, 15)


def fit_smooth_model(cells: Cells, floodlit: Pictures, pictures: SplitPictures) -> SmoothModel:
    """Fit the indirect light of all channels.

    The basis is refined, and the cores are fitted, to the sum of the channels. Each channel's fit
    starts from that, scaled to the channel's indirect light.

    Parameters
    ----------
    cells : Cells
        `fit_cells` of the ray domain.
    floodlit : Pictures
        The floodlit picture alone.
    pictures : SplitPictures
        All other pictures.
    """
    grey = floodlit.grey()
    data = channel_data(cells, grey, pictures.grey())
    patches = patches_of(_refined_basis(cells, data, has_light=grey.has_light()))
    basis = patches.basis
    cores = np.zeros((pictures.channels, len(basis.first)), np.float32)
    if not grey.has_light():
        return SmoothModel(cells, basis.functions, cores)
    problem = CoreProblem.from_data(patches, data)
    # in the first fit, cores that few patterns determine stay near 0; their deviations are learned
    # from the rest of their group
    estimate = problem.solve(prior_deviations(basis, data), _FIRST)
    deviations = learned_deviations(_core_groups(basis), estimate)
    estimate = problem.solve(deviations, _FINAL, estimate)
    if pictures.channels == 1:
        cores[0] = estimate
        return SmoothModel(cells, basis.functions, cores)
    for index in range(pictures.channels):
        channel = floodlit.channel(index)
        if not channel.has_light():
            continue
        single = channel_data(cells, channel, pictures.channel(index))
        scale = np.float32(single.core_scale / data.core_scale if data.core_scale else 0)
        single_problem = CoreProblem.from_data(patches, single)
        cores[index] = single_problem.solve(scale * deviations, _CHANNEL, scale * estimate)
    return SmoothModel(cells, basis.functions, cores)


def _refined_basis(cells: Cells, data: ChannelData, *, has_light: bool) -> MultiscaleBasis:
    """Add functions scale by scale where the pictures' dark pixels are not explained."""
    shape = cells.grid_shape

    def fit(functions: FunctionTable, _: MultiscaleBasis | None) -> MultiscaleBasis | None:
        basis = MultiscaleBasis(shape, functions)
        return basis if len(basis.first) <= _MOST_PAIRS else None

    def cells_to_refine(basis: MultiscaleBasis, scale: int) -> NDArray[np.bool_]:
        if not has_light:
            return np.zeros(scale_cells(shape, scale), np.bool_)
        problem = CoreProblem.from_data(patches_of(basis), data)
        cores = problem.solve(prior_deviations(basis, data), _COARSE)
        received = exchanged(basis, basis.pairs, cores, problem.light[:, :-1])
        indirect = (basis.weights @ received).T
        indirect *= data.dark_factor
        return _unexplained_cells(shape, scale, data, data.dark - indirect)

    return coarse_to_fine(shape, fit, cells_to_refine)


def _unexplained_cells(
    shape: tuple[int, ...], scale: int, data: ChannelData, errors: Float
) -> NDArray[np.bool_]:
    """Find the cells of a scale where errors (P, M') of dark pixels exceed noise and 0.5 % of F."""
    variance = data.dark_variance
    squared_error = np.where(variance > 0, errors * errors, 0).sum(axis=0, dtype=np.float64)
    noise = variance.sum(axis=0, dtype=np.float64)
    half_variance = np.square(variance, dtype=np.float64).sum(axis=0)
    allowed = _REFINED_AT**2 * np.square(data.dark_factor, dtype=np.float64).sum(axis=0)
    grid, cell = RayDomain(shape).square_cells(scale)
    return beyond_noise(grid, cell, squared_error, noise, half_variance, allowed)


@dataclass(frozen=True)
class ChannelData:
    """Weighted data from the pictures of one channel, for any basis.

    Attributes
    ----------
    factor : ndarray of float32, shape (M',)
        F, the floodlit image summed over cells, in radiance.
    light, dark, dark_factor, dark_variance : ndarray of float32, shape (P, M')
        Floodlit image of lit pixels; radiance, floodlit image and variance of known dark pixels.
    dark_weight, lit_weight, dark_data, lit_data : ndarray of float32, shape (P, M')
        w, and w times the data y, of the dark and of the lit pixels of each cell.
    indirect : float
        Indirect light under full light, as a fraction of the floodlit image: twice the mean of dark
        pixels, since most patterns light half of the pixels. Strips light less, which makes it
        slightly too small.
    floodlit : float
        Mean of F over the cells, in radiance.
    """

    factor: Float
    light: Float
    dark: Float
    dark_factor: Float
    dark_variance: Float
    dark_weight: Float
    lit_weight: Float
    dark_data: Float
    lit_data: Float
    indirect: float
    floodlit: float

    @property
    def core_scale(self) -> float:
        """Typical size of a core times its prior area in cells, in inverse radiance."""
        return self.indirect / max(self.floodlit, TINY)


def channel_data(cells: Cells, floodlit: Pictures, pictures: SplitPictures) -> ChannelData:
    """Compute the weighted data of one channel from its floodlit picture and all others."""
    image, light = floodlit.floodlit, pictures.light[:, 0]
    factor = cells.total(image)[:, 0]
    known = cells.total(image * floodlit.known)[:, 0]
    share = np.divide(known, factor, out=np.zeros_like(factor), where=factor != 0)
    lit_factor, dark_factor = light * share, (factor - light) * share
    dark, dark_variance = pictures.dark[:, 0], pictures.dark_variance[:, 0]
    dark_factor[dark_variance == 0] = 0
    dark_weight, dark_data = _weighted(dark_factor, dark, dark_variance)
    lit_weight, lit_data = _weighted(lit_factor, pictures.excess[:, 0], pictures.lit_variance[:, 0])
    mean = float(image.mean(dtype=np.float64))
    # where the light of a prior is subtracted, sums of a row may be negative
    by_row = dark.reshape(len(dark), -1, cells.grid_shape[-1]).sum(axis=-1, dtype=np.float64)
    dark_sum = float(np.abs(by_row).sum())
    indirect = 2 * dark_sum / max(float(pictures.dark_count.sum()), 1.0)
    return ChannelData(
        factor, light, dark, dark_factor, dark_variance, dark_weight, lit_weight, dark_data,
        lit_data, indirect / mean if mean else 0.0,
        float(factor.mean(dtype=np.float64)),
    )  # fmt: skip


def _weighted(factor: Float, light: Float, variance: Float) -> tuple[Float, Float]:
    """Compute ``w = F^2 / var`` and ``w y = F light / var``; 0 where the variance is 0."""
    total = variance + np.square(_MODEL_ERROR * factor)
    certainty = np.divide(1, total, where=variance > 0, out=np.zeros_like(total))
    certainty *= factor
    return certainty * factor, certainty * light


@dataclass(frozen=True)
class Patches:
    """Square patches of cells over which the functions of a basis hardly vary.

    Attributes
    ----------
    basis : MultiscaleBasis
    membership : csr_array of float32, shape (patches, M')
        1 where a cell belongs to a patch. A patch's side is half of its finest function's
        scale, between 1 and 16 cells.
    values : csr_array of float32, shape (patches, n)
        Mean of each function over each patch.
    """

    basis: MultiscaleBasis
    membership: csr_array[np.float32]
    values: csr_array[np.float32]


def patches_of(basis: MultiscaleBasis) -> Patches:
    """Divide the grid of a basis into patches."""
    from scipy.sparse import csr_array, diags_array

    weights = basis.weights
    finest = np.minimum.reduceat(basis.scales[weights.indices], weights.indptr[:-1])
    side = np.clip(finest // 2, 1, 16)
    stack = views, height, width = RayDomain(basis.shape).stack_shape
    rays = np.arange(len(finest))
    view, row, column = np.unravel_index(rays, stack)
    key = ((side * views + view) * height + row // side) * width + column // side
    _, patch = np.unique(key, return_inverse=True)
    ones, shape = np.ones(len(rays), np.float32), (int(patch.max()) + 1, len(rays))
    membership = csr_array((ones, (patch, rays)), shape=shape)
    share = np.float32(1) / np.diff(membership.indptr).astype(np.float32)
    means = (diags_array(share) @ (membership @ weights)).tocsr()
    values: csr_array[np.float32] = means.astype(np.float32)
    return Patches(basis, membership, values)


@dataclass(frozen=True)
class CoreProblem:
    """The least-squares problem of one channel's cores, patch by patch.

    Attributes
    ----------
    patches : Patches
    light : ndarray of float32, shape (n, P + 1)
        L, the light of each pattern and of full light on each function, in radiance.
    dark_weight, lit_weight : ndarray of float32, shape (patches, P)
        Summed weights w of a patch's dark and of its lit pixels.
    weighted : ndarray of float32, shape (n, P + 1)
        ``B^T`` of the summed data w y for the light of each pattern; for full light, minus the sums
        of the lit pixels.
    """

    patches: Patches
    light: Float
    dark_weight: Float
    lit_weight: Float
    weighted: Float

    @classmethod
    def from_data(cls, patches: Patches, data: ChannelData) -> CoreProblem:
        """Sum the data of cells over patches."""
        basis, membership = patches.basis, patches.membership
        light = basis.sums @ np.concatenate([data.light, data.factor[None]]).T
        lit_data = membership @ data.lit_data.T
        full = -lit_data.sum(axis=1, keepdims=True)
        weighted = np.concatenate([membership @ data.dark_data.T + lit_data, full], axis=1)
        dark_weight, lit_weight = (
            membership @ weight.T for weight in (data.dark_weight, data.lit_weight)
        )
        return cls(patches, light, dark_weight, lit_weight, patches.values.T @ weighted)

    def solve(
        self, deviations: Float, accuracy: tuple[float, int], start: Float | None = None
    ) -> Float:
        """Compute the cores (pairs,) by conjugate gradients.

        Cores are 0 that are expected to have little of the light, see `_INSIGNIFICANT`.

        Parameters
        ----------
        deviations : ndarray of float32, shape (pairs,)
            sigma; unknowns are cores divided by them, for a well-conditioned problem.
        accuracy : tuple of float and int
            Relative residual at which to stop, and largest number of iterations.
        start : ndarray of float32, shape (pairs,), optional
            First estimate of the cores.
        """
        expected = self._diagonal() * np.square(deviations)
        least = threshold_below(expected, _INSIGNIFICANT * float(expected.sum(dtype=np.float64)))
        fitted = np.flatnonzero(expected >= least)
        first, second = self.patches.basis.pairs
        aligned = self._aligned()
        normal = NormalEquations(aligned, first[fitted], second[fitted], deviations[fitted])
        conditioner = np.float32(1) / (1 + expected[fitted])
        if start is not None:
            start, sigma = start[fitted], normal.deviations
            start = np.divide(start, sigma, out=np.zeros_like(sigma), where=sigma > 0)
        goal = normal.adjoint(aligned.weighted)
        unknowns = conjugate_gradients(normal.product, goal, conditioner.__mul__, start, *accuracy)
        step()
        cores = np.zeros_like(deviations)
        cores[fitted] = normal.deviations * unknowns
        return cores

    def _aligned(self) -> CoreProblem:
        """Add patterns without light, so that the rows of all tables fill cache lines."""
        blank = [self.dark_weight.shape[1]] * (-self.light.shape[1] % _CACHE_LINE)
        light, dark_weight, lit_weight, weighted = (
            np.insert(columns, blank, 0, axis=1)
            for columns in (self.light, self.dark_weight, self.lit_weight, self.weighted)
        )
        return CoreProblem(self.patches, light, dark_weight, lit_weight, weighted)

    def _diagonal(self) -> Float:
        """Approximate the diagonal of the normal equations' matrix, (pairs,)."""
        basis, values = self.patches.basis, self.patches.values.T
        certainty = (self.dark_weight + self.lit_weight).mean(axis=1)
        weight = values.multiply(values) @ certainty
        power = np.square(self.light).sum(axis=1)
        forward = weight[basis.first] * power[basis.second]
        backward = weight[basis.second] * power[basis.first]
        diagonal: Float = forward + np.where(basis.first == basis.second, 0, backward)
        return diagonal


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of some of the cores; the unknowns are cores over their deviations.

    Attributes
    ----------
    problem : CoreProblem
    first, second : ndarray of int32, shape (fitted pairs,)
        Numbers of each pair's two functions.
    deviations : ndarray of float32, shape (fitted pairs,)
        sigma.
    """

    problem: CoreProblem
    first: Numbers
    second: Numbers
    deviations: Float

    def product(self, unknowns: Float) -> Float:
        """Multiply unknowns by the matrix."""
        from rfpipe.methods.near_far.kernels import PatchValues, weigh
        from rfpipe.transport.pair_kernels import couple

        problem, B = self.problem, self.problem.patches.values
        received, weighted = np.zeros_like(problem.light), np.zeros_like(problem.light)
        couple(self.first, self.second, self.deviations * unknowns, problem.light, received)
        values = PatchValues(B.indptr, B.indices, B.data)
        weigh(values, problem.dark_weight, problem.lit_weight, received, weighted)
        result = self.adjoint(weighted)
        result += unknowns
        return result

    def adjoint(self, received: Float) -> Float:
        """Apply the adjoint of unknowns -> S L to light received by the functions, (n, P + 1)."""
        from rfpipe.transport.pair_kernels import correlate

        result = np.empty_like(self.deviations)
        correlate(self.first, self.second, received, self.problem.light, result)
        result *= self.deviations
        return result


def prior_deviations(basis: MultiscaleBasis, data: ChannelData) -> Float:
    """Compute the deviations of cores that are assumed before any fit, (pairs,)."""
    deviations = data.core_scale / prior_areas(basis)
    return deviations.astype(np.float32)


def _core_groups(basis: MultiscaleBasis) -> NDArray[np.int64]:
    """Number the groups of cores that share a deviation: two scales at about the same distance."""
    first, second = basis.scales[basis.first], basis.scales[basis.second]
    distance_bin = (2 * basis.distances() / np.maximum(first, second)).astype(np.int64)
    # scales are below 2^20 pixels
    key = distance_bin << 40 | first.astype(np.int64) << 20 | second
    groups: NDArray[np.int64] = np.unique(key, return_inverse=True)[1]
    return groups
