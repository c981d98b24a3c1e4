"""The least-squares problem of near/far acquisition, and its solution by conjugate gradients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.methods.conjugate_gradients import conjugate_gradients
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.transport.multiscale.basis import MultiscaleBasis
from rfpipe.transport.multiscale.transport import bounced

if TYPE_CHECKING:
    from scipy.sparse import csr_array


# Pixels are taken together over a quarter of the finest function's scale, at most so many a side.
_PART_OF_SCALE, _LARGEST_PATCH = 4, 8
# Octaves of distance among which indirect light is shared a priori: rather many, for small cores;
# the data soon say better.
_OCTAVES = 12.0
_BINS_PER_SCALE = 2
# Scales are images' extents at most.
_SCALE_BITS = 20


@dataclass(frozen=True)
class Evidence:
    """What pictures of one channel tell, pixel by pixel, whatever the functions.

    Attributes
    ----------
    factor : ndarray of float32, shape (N,)
        F, the floodlit image.
    pattern : ndarray of bool, shape (M, N)
    weight, shown : ndarray of float32, shape (M, N)
        Weights of pixels, and weighted sums of what they show, divided by F.
    indirect, floodlit : float
        See `Observations`.
    """

    factor: Float
    pattern: NDArray[np.bool_]
    weight: Float
    shown: Float
    indirect: float
    floodlit: float

    @classmethod
    def of(cls, pictures: Pictures, share: float) -> Evidence:
        """Take the evidence out of pictures of one channel.

        Parameters
        ----------
        pictures : Pictures
        share : float
            Error of the model that is expected on a pixel, as a fraction of the floodlit image.
        """
        factor, known = pictures.floodlit[0], pictures.known
        direct = np.where(known, pictures.floodlit_variance[0], 0)  # else 0 times infinity
        wrong, squared = np.square(share * factor), np.square(factor)
        weight, shown = (np.empty(pictures.lit.shape, np.float32) for _ in range(2))
        # one picture at a time: all together take as much memory as all else
        for index, (lit, variance, radiance) in enumerate(
            zip(pictures.lit, pictures.variance[:, 0], pictures.radiance[:, 0], strict=True)
        ):
            spread = variance + lit * direct + wrong
            certainty = np.divide(1, spread, where=spread > 0, out=np.zeros_like(spread))
            weight[index] = certainty * squared
            shown[index] = certainty * factor * (radiance - lit * factor)
        mean = float(factor.mean(dtype=np.float64))
        seen = pictures.radiance[:, 0].T * ~pictures.lit.T
        pixels_dark = max(float(np.count_nonzero(~pictures.lit[:, known])), 1.0)
        indirect = 2 * float(seen.sum(dtype=np.float64)) / pixels_dark
        return cls(
            factor,
            pictures.lit,
            weight,
            shown,
            max(indirect, 0.0) / mean if mean else 0.0,
            mean,
        )

    @property
    def core(self) -> float:
        """How large cores are, in inverse radiance, but for their number and places."""
        return self.indirect / max(self.floodlit, float(np.finfo(np.float32).tiny))


class Patches:
    """Pixels put together where only coarse functions are.

    Parameters
    ----------
    basis : MultiscaleBasis

    Attributes
    ----------
    together : csr_array of float32, shape (patches, N)
        Which pixels.
    weights : csr_array of float32, shape (patches, n)
        The functions' means over each patch.
    back : csr_array of float32, shape (n, patches)
        Their transpose.
    """

    def __init__(self, basis: MultiscaleBasis) -> None:
        self.basis, self.together = basis, _patches(basis)
        pixels: Float = np.diff(self.together.indptr).astype(np.float32)
        self.weights = _rows_scaled(self.together @ basis.weights, np.float32(1) / pixels)
        self.back: csr_array[np.float32] = self.weights.T.tocsr()


@dataclass(frozen=True)
class Observations:
    """What pictures tell of the cores, patch by patch of pixels.

    Attributes
    ----------
    patches : Patches
    light : ndarray of float32, shape (n, M + 1)
        ``B^T F p`` of each pattern, and of full light.
    dark, lit : ndarray of float32, shape (patches, M)
        Weights of a patch's dark and of its lit pixels.
    seen_dark, seen_lit : ndarray of float32, shape (patches, M)
        Weighted sums of what they show, divided by F.
    indirect : float
        Indirect light on dark pixels as a fraction of the floodlit image, doubled, since patterns
        light half of the pixels.
    floodlit : float
        Mean of the floodlit image.
    """

    patches: Patches
    light: Float
    dark: Float
    lit: Float
    seen_dark: Float
    seen_lit: Float
    indirect: float
    floodlit: float

    @classmethod
    def of(cls, patches: Patches, evidence: Evidence) -> Observations:
        """Sum evidence over patches, one picture at a time."""
        count = len(evidence.pattern)
        light = np.empty((len(patches.basis), count + 1), np.float32)
        dark, lit, seen_dark, seen_lit = (
            np.empty((patches.together.shape[0], count), np.float32) for _ in range(4)
        )
        for index, pattern in enumerate(evidence.pattern):
            light[:, index] = patches.basis.sums @ (pattern * evidence.factor)
            weight, shown = evidence.weight[index], evidence.shown[index]
            dark[:, index] = patches.together @ (weight * ~pattern)
            lit[:, index] = patches.together @ (weight * pattern)
            seen_dark[:, index] = patches.together @ (shown * ~pattern)
            seen_lit[:, index] = patches.together @ (shown * pattern)
        light[:, count] = patches.basis.sums @ evidence.factor
        return cls(
            patches, light, dark, lit, seen_dark, seen_lit, evidence.indirect, evidence.floodlit
        )

    @property
    def basis(self) -> MultiscaleBasis:
        """The functions."""
        return self.patches.basis


@dataclass(frozen=True)
class Prior:
    """How large cores are expected to be: independent normal deviates about zero.

    Attributes
    ----------
    deviations : ndarray of float32, shape (pairs,)
    group : ndarray of int64, shape (pairs,)
        Pairs of the same two scales at about the same distance.
    """

    deviations: Float
    group: NDArray[np.int64]

    @classmethod
    def of(cls, basis: MultiscaleBasis, seen: Observations) -> Prior:
        """Return the prior before any fit: indirect light falls with the distance's square."""
        distance = basis.distances()
        first, second = basis.scales[basis.first], basis.scales[basis.second]
        coarser = np.maximum(first, second)
        area = np.square(np.maximum(distance, coarser)) * _OCTAVES
        expected = seen.indirect / (max(seen.floodlit, float(np.finfo(np.float32).tiny)) * area)
        distance_bin = (_BINS_PER_SCALE * distance / coarser).astype(np.int64)
        key = distance_bin << 2 * _SCALE_BITS | first.astype(np.int64) << _SCALE_BITS | second
        _, group = np.unique(key, return_inverse=True)
        return cls(expected.astype(np.float32), group)

    def learned(self, cores: Float) -> Float:
        """Return each group's deviation as the root of its cores' mean square."""
        energy = np.bincount(self.group, np.square(cores, dtype=np.float64))
        deviations = np.sqrt(energy / np.bincount(self.group))[self.group]
        return deviations.astype(np.float32)


def solve(
    seen: Observations, deviations: Float, tolerance: float, most: int, start: Float | None = None
) -> Float:
    """Find the cores by preconditioned conjugate gradients.

    Parameters
    ----------
    seen : Observations
    deviations : ndarray of float32, shape (pairs,)
        Of the prior.
    tolerance : float
        Part of the residual at which to stop.
    most : int
        Iterations at most.
    start : ndarray of float32, shape (pairs,), optional

    Returns
    -------
    ndarray of float32, shape (pairs,)
    """
    gradient = deviations * _adjoint(seen, _weighed(seen.seen_dark, seen.seen_lit))
    scaling = np.float32(1) / (1 + _diagonal(seen) * np.square(deviations))
    begun = np.zeros_like(gradient)
    if start is not None:
        np.divide(start, deviations, out=begun, where=deviations > 0)
    normal = partial(_normal, seen, deviations)
    return deviations * conjugate_gradients(normal, gradient, scaling, begun, tolerance, most)


def residual(basis: MultiscaleBasis, pictures: Pictures, cores: Float) -> Float:
    """Return what the model leaves of the dark pixels of one channel's pictures, (M, N)."""
    left: Float = pictures.radiance[:, 0] - bounced(
        basis, basis.pairs, cores, pictures.floodlit[0], pictures.lit
    )
    return left


def _normal(seen: Observations, deviations: Float, known: Float) -> Float:
    """Apply the normal equations' matrix, in units of the prior's deviations."""
    from rfpipe.methods.near_far.kernels import weigh
    from rfpipe.transport.multiscale.kernels import couple

    received = np.zeros_like(seen.light)
    basis, patches = seen.basis, seen.patches
    couple(basis.first, basis.second, deviations * known, seen.light, received)
    arriving = patches.weights @ received
    weigh(arriving, seen.dark, seen.lit, arriving)
    result = _adjoint(seen, arriving)
    result *= deviations
    result += known
    return result


def _weighed(dark: Float, lit: Float) -> Float:
    """Return weighted pictures of the patches as light of each pattern, and of full light."""
    return np.concatenate([dark + lit, -lit.sum(axis=1, keepdims=True)], axis=1)


def _adjoint(seen: Observations, back: Float) -> Float:
    """Bring weighted light of the patches, see `_weighed`, back to the pairs."""
    from rfpipe.transport.multiscale.kernels import correlate

    basis = seen.basis
    out = np.empty(len(basis.first), np.float32)
    correlate(basis.first, basis.second, seen.patches.back @ back, seen.light, out)
    return out


def _diagonal(seen: Observations) -> Float:
    """Estimate the diagonal of the normal equations' matrix, pair by pair."""
    basis = seen.basis
    certainty = (seen.dark + seen.lit).mean(axis=1)
    back = seen.patches.back
    weight = back.multiply(back) @ certainty
    light = np.square(seen.light).sum(axis=1)
    one = weight[basis.first] * light[basis.second]
    other = np.where(basis.first == basis.second, 0, weight[basis.second] * light[basis.first])
    diagonal: Float = one + other
    return diagonal


def _patches(basis: MultiscaleBasis) -> csr_array[np.float32]:
    """Put pixels together where only coarse functions are; sparse ones (patches, N)."""
    from scipy.sparse import csr_array

    weights = basis.weights
    finest = np.minimum.reduceat(basis.scales[weights.indices], weights.indptr[:-1])
    side = np.clip(finest // _PART_OF_SCALE, 1, _LARGEST_PATCH)
    stack = views, height, width = RayDomain(basis.shape).stack_shape
    rays = np.arange(len(finest))
    view, row, column = np.unravel_index(rays, stack)
    key = ((side * views + view) * height + row // side) * width + column // side
    _, patch = np.unique(key, return_inverse=True)
    ones = np.ones(len(rays), np.float32)
    return csr_array((ones, (patch, rays)), shape=(int(patch.max()) + 1, len(rays)))


def _rows_scaled(matrix: Any, scale: Float) -> csr_array[np.float32]:
    from scipy.sparse import diags_array

    scaled: csr_array[np.float32] = (diags_array(scale) @ matrix).tocsr().astype(np.float32)
    return scaled
