"""Weights of footprints: the light that each candidate projector pixel contributes.

For camera pixel i with k candidates and P pictures, the weights x minimise

    (d - A x)^T W (d - A x) + (x - e)^T G^-1 (x - e),    x >= 0

where d is the direct light in the pictures: row i of ``c - z``, with the estimated indirect light z
(`rfpipe.methods.footprints.indirect`). The fit of indirect light needs the pictures but not the
weights, which are marginalised: the covariance of d becomes ``W^-1 + A G A^T``, and its inverse is
the pixel's *precision* Lambda.

==========  ============  =====================  =======  ==========================================
symbol      of one pixel  name in the code       shape    meaning and unit
==========  ============  =====================  =======  ==========================================
``A``       (P, k)        rows of `patterns`     (N, P)   light of each candidate in each pattern,
                                                          0 to 1
``x``       (k,)          `Candidates.weights`   (K,)     row i of D at its candidates, radiance
``d``       (P,)          `radiance`             (M, P)   pictures minus indirect light, radiance
``W``       (P, P)        `inverse_variance`     (M, P)   diagonal matrix: 1 / variance of d
``e``       (k,)          `mean`                 (K,)     prior mean of the weights, radiance
``G``       (k, k)        `Candidates.variance`  (K,)     diagonal matrix: prior variance, radiance
                                                          squared
``Lambda``  (P, P)        `MarginalPrecision`             precision, by its factors
==========  ============  =====================  =======  ==========================================

The arrays of the code have all camera pixels, and only the diagonals of W and G.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from rfpipe.array_types import TINY, Double, Float, Index
from rfpipe.methods.footprints.candidates import Candidates, join_pixels
from rfpipe.methods.footprints.pictures import IndirectPictures, ViewArrays, ViewPictures

MODEL_ERROR = 0.003
"""Error of the model in the fit of weights, relative to the floodlit image."""


# Weights that explain less than this many squared standard deviations of the pictures become 0.
_LEAST_EVIDENCE = 12.0
# Prior standard deviation for the next fit: fractions of the weight and of the floodlit image.
_NEXT_PRIOR = (1.0, 0.03)


def fit_weights(
    candidates: Candidates,
    pictures: ViewPictures,
    indirect: IndirectPictures,
    mean: Float | None = None,
) -> Candidates:
    """Fit the weights to the pictures minus indirect light, a range of camera pixels at a time.

    Parameters
    ----------
    candidates : Candidates
        With prior variances. Their weights are the first estimate.
    pictures : ViewPictures
    indirect : IndirectPictures
        Indirect light in the pictures, radiance.
    mean : ndarray of float32, shape (K,), optional
        Prior means of the weights; 0 by default.

    Returns
    -------
    Candidates
        With the prior standard deviation for the next fit: the weight, and 3 % of the floodlit
        image.
    """
    parts = []
    for first, last in pictures.ranges():
        pixels = slice(first, last)
        entries = slice(*candidates.starts[[first, last]])
        part = fit_weights_of_part(
            candidates.between(first, last),
            pictures.at(pixels),
            indirect[pixels],
            None if mean is None else mean[entries],
        )
        parts.append(part)
    return join_pixels(parts)


def fit_weights_of_part(
    candidates: Candidates, pictures: ViewArrays, indirect: Float, mean: Float | None = None
) -> Candidates:
    """Fit the weights of some camera pixels (m,); `indirect` has the light there, (m, P)."""
    fitted = non_negative_weights(
        candidates,
        pictures.floodlit,
        pictures.patterns,
        (pictures.radiance - indirect).astype(np.float32),
        pictures.inverse_variance(MODEL_ERROR),
        mean,
    )
    return fitted.with_variance(pictures.floodlit, *_NEXT_PRIOR)


def non_negative_weights(
    candidates: Candidates,
    floodlit: Float,
    patterns: Float,
    radiance: Float,
    inverse_variance: Float,
    mean: Float | None = None,
) -> Candidates:
    """Compute the non-negative weights that explain pictures best, by the module's equation.

    Parameters
    ----------
    candidates : Candidates
        With prior variances. Their weights are the first estimate, which affects only the time.
    floodlit : ndarray of float32, shape (M,)
    patterns : ndarray of float32, shape (N, P)
    radiance, inverse_variance : ndarray of float32, shape (M, P)
        d and the diagonals of W.
    mean : ndarray of float32, shape (K,), optional
        e; 0 by default.
    """
    from rfpipe.methods.footprints.kernels import (
        CandidateRows,
        PixelPictures,
        WeightPrior,
        solve_weights,
    )

    patterns, inverse_variance, radiance = map(
        np.ascontiguousarray, (patterns, inverse_variance, radiance)
    )
    least = np.square(1e-4 * floodlit[candidates.camera_pixels])
    # reciprocity can make candidates of a black pixel, whose prior variance is 0
    prior_precision = (1 / np.maximum(candidates.variance + least, TINY)).astype(np.float32)
    prior_mean = np.zeros_like(prior_precision) if mean is None else mean
    weights = solve_weights(
        CandidateRows(candidates.starts, candidates.projector_pixels, patterns),
        PixelPictures(radiance, inverse_variance),
        WeightPrior(prior_precision, prior_mean),
        candidates.weights,
        _LEAST_EVIDENCE,
    )
    return replace(candidates, weights=weights)


@dataclass(frozen=True)
class MarginalPrecision(ABC):
    """Inverse covariance Lambda of each camera pixel's pictures when its weights are unknown.

    Attributes
    ----------
    candidate_counts : ndarray of int64, shape (M,)
        Number of candidates of each camera pixel.
    trace : ndarray of float32, shape (M,)
        Trace of the precision of each pixel.
    """

    candidate_counts: Index
    trace: Float

    @abstractmethod
    def apply(self, pictures: Float) -> Float:
        """Multiply each camera pixel's pictures, (M, P), by its precision."""


@dataclass(frozen=True)
class LowRankPrecision(MarginalPrecision):
    """``Lambda = W - U^T U`` with the factors U of `kernels.marginal_factors`.

    Attributes
    ----------
    factors : ndarray of float64, shape (K, P)
        U.
    inverse_variance : ndarray of float32, shape (M, P)
        Diagonal of W.
    """

    factors: Double
    inverse_variance: Float

    def apply(self, pictures: Float) -> Float:
        """Multiply each camera pixel's pictures, (M, P), by its precision."""
        from rfpipe.methods.footprints.kernels import apply_precision

        starts = np.concatenate([[0], np.cumsum(self.candidate_counts)])
        contiguous = np.ascontiguousarray(pictures, np.float32)
        return apply_precision(starts, self.factors, self.inverse_variance, contiguous)


@dataclass(frozen=True)
class TriangularPrecision(MarginalPrecision):
    """``Lambda = C C^T`` with the Cholesky factors C, smaller than U where k > P / 4.

    Attributes
    ----------
    factors : ndarray of float32, shape (M, P (P + 1) / 2)
        Rows of the lower triangles C.
    """

    factors: Float

    def apply(self, pictures: Float) -> Float:
        """Multiply each camera pixel's pictures, (M, P), by its precision."""
        from rfpipe.methods.footprints.kernels import apply_triangles

        return apply_triangles(self.factors, np.ascontiguousarray(pictures, np.float32))


def marginal_precision(candidates: Candidates, pictures: ViewPictures) -> MarginalPrecision:
    """Marginalise the weights of candidates, whose prior mean is 0."""
    from rfpipe.methods.footprints.kernels import (
        CandidateRows,
        marginal_factors,
        marginal_triangles,
    )

    least = np.square(1e-3 * pictures.floodlit[candidates.camera_pixels])
    # reciprocity can make candidates of a black pixel, whose prior variance is 0
    variance = np.maximum(candidates.variance, np.maximum(least, TINY)).astype(np.float32)
    inverse_variance = pictures.inverse_variance()
    rows = CandidateRows(candidates.starts, candidates.projector_pixels, pictures.patterns)
    counts = np.diff(rows.starts)
    if 4 * len(variance) > inverse_variance.size:
        triangles, trace = marginal_triangles(rows, variance, inverse_variance)
        return TriangularPrecision(counts, trace, triangles)
    factors, trace = marginal_factors(rows, variance, inverse_variance)
    return LowRankPrecision(counts, trace, factors, inverse_variance)
