"""The least-squares problem of smooth indirect light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.methods.images import Pictures
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.methods.smooth_light import prior_areas
from rfpipe.steps import step
from rfpipe.transport.multiscale import MultiscaleBasis

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Evidence:
    """What pictures of one channel tell, pixel by pixel, whatever the functions.

    Attributes
    ----------
    factor : ndarray of float32, shape (N,)
        F, the floodlit image.
    lit : ndarray of bool, shape (P, N)
    weight, shown : ndarray of float32, shape (P, N)
        Weights of pixels, and weighted sums of what they show, divided by F.
    indirect : float
        Indirect light on dark pixels as a fraction of the floodlit image, doubled, since patterns
        light half of the pixels.
    floodlit : float
        Mean of the floodlit image.
    """

    factor: Float
    lit: NDArray[np.bool_]
    weight: Float
    shown: Float
    indirect: float
    floodlit: float

    @classmethod
    def of(cls, pictures: Pictures, share: float) -> Evidence:
        """Take the evidence out of one channel, whose model is off by `share` of its floodlight."""
        factor, known, probes = pictures.floodlit[0], pictures.known, pictures.probes
        direct = np.where(known, pictures.variance[0, 0], 0)  # else 0 times infinity
        wrong, squared = np.square(share * factor), np.square(factor)
        weight, shown = (np.empty(probes.lit.shape, np.float32) for _ in range(2))
        # one picture at a time: all together take as much memory as all else
        for index, (lit, variance, radiance) in enumerate(
            zip(probes.lit, probes.variance[:, 0], probes.radiance[:, 0], strict=True)
        ):
            spread = variance + lit * direct + wrong
            certainty = np.divide(1, spread, where=spread > 0, out=np.zeros_like(spread))
            weight[index] = certainty * squared
            shown[index] = certainty * factor * (radiance - lit * factor)
        mean = float(factor.mean(dtype=np.float64))
        dark = probes.radiance[:, 0].T * ~probes.lit.T
        pixels_dark = max(float(np.count_nonzero(~probes.lit[:, known])), 1.0)
        indirect = 2 * float(dark.sum(dtype=np.float64)) / pixels_dark
        return cls(
            factor, probes.lit, weight, shown, max(indirect, 0.0) / mean if mean else 0.0, mean
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
        Which pixels: over a quarter of the finest function's scale, at most 8 a side.
    weights : csr_array of float32, shape (patches, n)
        The functions' means over each patch.
    back : csr_array of float32, shape (n, patches)
        Their transpose.
    """

    def __init__(self, basis: MultiscaleBasis) -> None:
        from scipy.sparse import csr_array, diags_array

        self.basis = basis
        weights = basis.weights
        finest = np.minimum.reduceat(basis.scales[weights.indices], weights.indptr[:-1])
        side = np.clip(finest // 4, 1, 8)
        stack = views, height, width = RayDomain(basis.shape).stack_shape
        rays = np.arange(len(finest))
        view, row, column = np.unravel_index(rays, stack)
        key = ((side * views + view) * height + row // side) * width + column // side
        _, patch = np.unique(key, return_inverse=True)
        ones, shape = np.ones(len(rays), np.float32), (int(patch.max()) + 1, len(rays))
        self.together = csr_array((ones, (patch, rays)), shape=shape)
        share = np.float32(1) / np.diff(self.together.indptr).astype(np.float32)
        means = (diags_array(share) @ (self.together @ weights)).tocsr()
        self.weights: csr_array[np.float32] = means.astype(np.float32)
        self.back: csr_array[np.float32] = self.weights.T.tocsr()


@dataclass(frozen=True)
class Observations:
    """What pictures tell of the cores, patch by patch of pixels.

    Attributes
    ----------
    patches : Patches
    evidence : Evidence
    light : ndarray of float32, shape (n, P + 1)
        ``B^T F p`` of each pattern, and of full light.
    dark, lit : ndarray of float32, shape (patches, P)
        Weights of a patch's dark and of its lit pixels.
    observed : ndarray of float32, shape (patches, P + 1)
        Weighted sums of pictures, over F, as light of each pattern and of full light.
    """

    patches: Patches
    evidence: Evidence
    light: Float
    dark: Float
    lit: Float
    observed: Float

    @classmethod
    def of(cls, patches: Patches, evidence: Evidence) -> Observations:
        """Sum evidence over patches, one picture at a time."""
        count, together = len(evidence.lit), patches.together
        light = np.empty((len(patches.basis), count + 1), np.float32)
        dark, lit, on_dark, on_lit = (
            np.empty((together.shape[0], count), np.float32) for _ in range(4)
        )
        for index, pattern in enumerate(evidence.lit):
            light[:, index] = patches.basis.sums @ (pattern * evidence.factor)
            weight, shown = evidence.weight[index], evidence.shown[index]
            dark[:, index] = together @ (weight * ~pattern)
            lit[:, index] = together @ (weight * pattern)
            on_dark[:, index] = together @ (shown * ~pattern)
            on_lit[:, index] = together @ (shown * pattern)
        light[:, count] = patches.basis.sums @ evidence.factor
        full = -on_lit.sum(axis=1, keepdims=True)
        observed = np.concatenate([on_dark + on_lit, full], axis=1)
        return cls(patches, evidence, light, dark, lit, observed)

    def adjoint(self, back: Float) -> Float:
        """Bring weighted light of the patches (patches, P + 1) back to the pairs."""
        from rfpipe.transport.pair_kernels import correlate

        basis = self.patches.basis
        out = np.empty(len(basis.first), np.float32)
        correlate(basis.first, basis.second, self.patches.back @ back, self.light, out)
        return out

    def diagonal(self) -> Float:
        """Estimate the diagonal of the normal equations' matrix, pair by pair."""
        basis, back = self.patches.basis, self.patches.back
        certainty = (self.dark + self.lit).mean(axis=1)
        weight = back.multiply(back) @ certainty
        light = np.square(self.light).sum(axis=1)
        one = weight[basis.first] * light[basis.second]
        other = np.where(basis.first == basis.second, 0, weight[basis.second] * light[basis.first])
        diagonal: Float = one + other
        return diagonal


def expected(basis: MultiscaleBasis, evidence: Evidence) -> tuple[Float, NDArray[np.int64]]:
    """Return the deviations of cores before any fit, about zero, and each core's group.

    Indirect light falls with the distance's square. Pairs of the same two scales at about the same
    distance are a group.
    """
    distance = basis.distances()
    first, second = basis.scales[basis.first], basis.scales[basis.second]
    coarser = np.maximum(first, second)
    area = prior_areas(basis)
    tiny = float(np.finfo(np.float32).tiny)
    deviations = evidence.indirect / (max(evidence.floodlit, tiny) * area)
    distance_bin = (2 * distance / coarser).astype(np.int64)
    # scales are images' extents at most, below 2^20
    key = distance_bin << 40 | first.astype(np.int64) << 20 | second
    return deviations.astype(np.float32), np.unique(key, return_inverse=True)[1]


def solve(
    observed: Observations,
    deviations: Float,
    tolerance: float,
    most: int,
    start: Float | None = None,
) -> Float:
    """Find the cores (pairs,) by conjugate gradients, to a part `tolerance` of the residual.

    `deviations` are those of the prior, `most` the iterations at most.
    """
    from rfpipe.transport.pair_kernels import couple

    patches = observed.patches
    basis = patches.basis

    def normal(known: Float) -> Float:
        """Apply the normal equations' matrix, in units of the prior's deviations."""
        received = np.zeros_like(observed.light)
        couple(basis.first, basis.second, deviations * known, observed.light, received)
        arriving = patches.weights @ received
        # dark pixels see a pattern's light, lit ones how it differs from full light
        lacking = observed.lit * (arriving[:, :-1] - arriving[:, -1:])
        arriving[:, :-1] *= observed.dark
        arriving[:, :-1] += lacking
        arriving[:, -1] = -lacking.sum(axis=1)
        result = observed.adjoint(arriving)
        result *= deviations
        result += known
        return result

    goal = deviations * observed.adjoint(observed.observed)
    scaling = np.float32(1) / (1 + observed.diagonal() * np.square(deviations))
    if start is not None:
        start = np.divide(start, deviations, out=np.zeros_like(goal), where=deviations > 0)
    solution = conjugate_gradients(normal, goal, scaling.__mul__, start, tolerance, most)
    step()
    return deviations * solution
