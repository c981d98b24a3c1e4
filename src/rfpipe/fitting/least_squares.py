"""Regularised, non-negative least squares: the transport of each camera ray from all pictures.

Each row ``t`` of T is a Gaussian process over the projector's rays. With patterns P (K, N),
pictures ``y = P t`` of variance V, and the prior's covariance ``s C``,

    t = C P^T (P C P^T + V / s)^-1 y,    t >= 0.

====== ============ =============== =========================================================
symbol code         shape           meaning
====== ============ =============== =========================================================
P      patterns     (K, N)          weights of the projector's rays, each picture over its noise
C      spread       (K, N) as P C   correlation of entries: a common mean, and a Gaussian of some
                                    width over the projector's image
V / s  ridge, gain  scalar, (C, M)  noise over signal, squared, times the relative noise of a ray
====== ============ =============== =========================================================

One eigenvalue decomposition of ``P C P^T`` serves all camera rays. Width and ridge are those under
which the pictures are most probable, or, where their noise is unknown, those that cross-validation
prefers. For complete patterns and little noise all of them give the direct solution.

Entries below 0 are set to 0, and projected gradients fit the pictures again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Double, Float
from rfpipe.blocks import RayDomain
from rfpipe.fitting.series import Series
from rfpipe.transport.dense import DenseTransport

_RIDGES: Double = np.logspace(-10, 2, 25)
# Eigenvalues below this part of the largest one are rounding.
_ROUNDING = 1e-13
# Least ridge of patterns that don't determine each ray: nothing else bounds undetermined entries.
_LEAST_RIDGE = 1e-6
# Camera rays that choose the prior, of more.
_ENOUGH_RAYS = 512
# Gradients of the fit without negative entries. Of 252 photographs of 8 bits (12 x 14 rays, 30 to
# validate), 0, 5, 20 and 60 leave 1.27, .39, .30 and .27 %; with negative entries .47 %.
_GRADIENTS = 60
# A picture is strange when the others predict it worse than the median one by this factor, squared;
# its inverse is the least such error. In simulation, with half more random patterns than rays, good
# pictures reached 2.3 times the median, and exchanged, copied, turned and shuffled ones 168 times.
_STRANGE = 10.0


def solve_least_squares(series: Series, rows: list[dict[str, Any]]) -> DenseTransport:
    """Fit the most probable transport without negative entries.

    Parameters
    ----------
    series : Series
        Pictures; rows of unknown camera rays are 0.
    rows : list of dict
        The transport's table of levels.
    """
    matrix = np.zeros(
        (series.channels, series.radiance.shape[2], series.patterns.shape[2]), np.float32
    )
    known = series.of_rays(np.flatnonzero(series.known))
    channel = 0
    for lit_alike in known.by_light():
        for part in _solved(lit_alike):
            matrix[channel, series.known] = part
            channel += 1
    arrays = {"matrix": matrix}
    return DenseTransport(
        series.camera_shape, series.projector_shape, series.channels, rows, arrays
    )


def strange_pictures(series: Series) -> NDArray[np.intp]:
    """Return the numbers of pictures that the others predict far worse than most, worst first.

    With ``A = (P C P^T + V / s)^-1``, picture k differs by ``(A y)_k / A_kk`` from what the others
    predict, with variance ``1 / A_kk``. Coloured patterns are tested channel by channel.
    """
    known = series.of_rays(np.flatnonzero(series.known))
    strange = np.concatenate([_strange(lit_alike) for lit_alike in known.by_light()])
    return strange[np.sort(np.unique(strange, return_index=True)[1])]


def _solved(series: Series) -> list[Float]:
    """Return the matrices (M, N) of all channels of pictures under one light."""
    if series.are_single_lights:
        pictures, lights = np.nonzero(series.patterns[:, 0])
        columns = series.radiance[pictures] / series.patterns[pictures, :, lights][..., None]
        matrix = np.zeros((series.channels, series.radiance.shape[2], len(lights)), np.float32)
        matrix[..., lights] = np.maximum(np.moveaxis(columns, 0, -1), 0)
        return list(matrix)
    weights, gain = _weights(series), _gains(series)
    if not series.variance.any() and series.is_complete:
        basis, ridge = _Basis.of(series, weights, 0.0), _ROUNDING
    else:
        basis, ridge, _ = _most_probable(series, weights, gain)
    patterns = series.patterns[:, 0] * weights[:, None].astype(np.float32)
    return [
        _not_negative(basis, ridge * gain[channel], patterns, pictures)
        for channel, pictures in enumerate(
            np.moveaxis(series.radiance * weights[:, None, None].astype(np.float32), 1, 0)
        )
    ]


def _not_negative(basis: _Basis, penalty: Double, patterns: Float, pictures: Float) -> Float:
    """Return T (M, N) >= 0 of pictures (K, M), by accelerated projected gradients.

    They begin at the most probable solution with its negative entries set to 0 [Beck and Teboulle,
    A fast iterative shrinkage-thresholding algorithm, 2009].
    """
    matrix = np.maximum(basis.solution(pictures, penalty), 0)
    step = np.float32(1 / max(float(np.linalg.norm(patterns, 2)) ** 2, TINY))
    ahead, momentum = matrix, 1.0
    for _ in range(_GRADIENTS):
        gradient = (patterns @ ahead.T - pictures).T @ patterns
        updated = np.maximum(ahead - step * gradient, 0)
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = updated + np.float32((momentum - 1) / grown) * (updated - matrix)
        matrix, momentum = updated, grown
    return matrix


def _strange(series: Series) -> NDArray[np.intp]:
    """Return `strange_pictures` of pictures under one light."""
    basis, ridge, observed = _most_probable(series, _weights(series), _gains(series))
    count, vectors = len(observed), basis.vectors
    inverse = (vectors / (basis.values + ridge)) @ vectors.T
    inverse += (np.eye(count) - vectors @ vectors.T) / ridge
    pictures, diagonal = observed.reshape(count, -1), np.diag(inverse)
    wrong = np.square(inverse @ pictures).sum(axis=1)
    light = np.square(pictures).sum(axis=1)
    score, is_off = wrong / diagonal, wrong > light * np.square(diagonal / _STRANGE)
    worst = np.argsort(-score)
    strange = is_off & (score > _STRANGE * np.median(score))
    return np.asarray(worst[strange[worst]])


def _weights(series: Series) -> Double:
    """Return the pictures' weights: one over their standard deviations, relative to the mean's."""
    variance = series.variance.mean(axis=(1, 2), dtype=np.float64)
    if not variance.any():
        return np.ones(len(variance))
    # a variance of 0 means unknown noise
    return np.asarray(1 / np.sqrt(np.maximum(variance / variance.mean(), 1e-3)))


def _most_probable(series: Series, weights: Double, gain: Double) -> tuple[_Basis, float, Double]:
    """Return the prior's basis and ridge, and the weighted pictures (K, C, m) that chose them."""
    rays = series.radiance.shape[2]
    chosen = np.unique(np.linspace(0, rays - 1, min(rays, _ENOUGH_RAYS)).astype(np.int64))
    observed = series.radiance[:, :, chosen].astype(np.float64) * weights[:, None, None]
    spread = series.variance[:, :, chosen] * np.square(weights)[:, None, None]
    noise = spread.mean(axis=0, dtype=np.float64)
    longest = max(RayDomain(series.projector_shape).image_shape)
    fits = []
    for scale in [0.0, *(2.0**power for power in range(8) if 2 ** (power + 1) <= longest)]:
        basis = _Basis.of(series, weights, scale)
        scores = basis.scores(observed, gain[:, chosen], noise)
        # cross-validation takes the least ridge whose score is about the best one's
        index = int(np.argmax(scores <= (1 if noise.any() else 1.02) * scores.min()))
        fits.append((float(scores[index]), basis, float(_RIDGES[index])))
    _, basis, ridge = min(fits, key=lambda fit: fit[0])
    return basis, ridge if series.is_complete else max(ridge, _LEAST_RIDGE), observed


@dataclass(frozen=True, eq=False)
class _Basis:
    """Eigenvalue decomposition of ``P C P^T``.

    Attributes
    ----------
    values : ndarray of float64, shape (R,)
        Eigenvalues above 0 over the largest, descending.
    vectors : ndarray of float64, shape (K, R)
    right : ndarray of float64, shape (R, N)
        Eigenvectors times ``P C``, over the largest eigenvalue.
    """

    values: Double
    vectors: Double
    right: Double

    @classmethod
    def of(cls, series: Series, weights: Double, scale: float) -> _Basis:
        """Decompose weighted patterns under a prior of one width, in projector pixels."""
        patterns = series.patterns[:, 0].astype(np.float64) * weights[:, None]
        spread = _spread(patterns, series.projector_shape, scale)
        values, vectors = np.linalg.eigh(patterns @ spread.T)
        largest = max(float(values[-1]), np.finfo(np.float64).tiny)
        used = values > _ROUNDING * largest
        values, vectors = values[used][::-1], vectors[:, used][:, ::-1]
        return cls(values / largest, vectors, (vectors.T @ spread) / largest)

    def scores(self, observed: Double, gain: Double, noise: Double) -> Double:
        """Score each ridge for pictures (K, C, m) of noise (C, m); less is better.

        The negative logarithm of the pictures' probability where the noise is known; otherwise the
        score of generalised cross-validation.
        """
        along = np.square(np.einsum("kr,kcm->rcm", self.vectors, observed, optimize=True))
        light = np.square(observed).sum(axis=0)
        outside = np.maximum(light - along.sum(axis=0), 0)
        silent = len(self.vectors) - len(self.values)
        shining, is_known = noise > 0, bool(noise.any())
        scores = np.empty(len(_RIDGES))
        for index, ridge in enumerate(_RIDGES):
            penalty = ridge * gain
            variance = self.values[:, None, None] + penalty
            if is_known:
                unit = np.where(shining, noise, 1) / penalty
                misfit = (along / variance).sum(axis=0) + (outside / penalty if silent else 0)
                logs = np.log(variance).sum(axis=0) + silent * np.log(penalty)
                score = len(observed) * np.log(unit) + logs + misfit / unit
                scores[index] = float(score[shining].sum())
            else:
                share = penalty / variance
                missed = (np.square(share) * along).sum(axis=0) + outside
                free = np.square(share.sum(axis=0) + silent)
                scores[index] = float((missed / free / np.maximum(light, TINY)).mean())
        return scores

    def solution(self, pictures: Float, penalty: Double) -> Float:
        """Return T (M, N) of weighted pictures (K, M) with a penalty (M,) for each ray."""
        inverse = 1 / (self.values[:, None] + penalty)
        coefficients = inverse * (self.vectors.T @ pictures)
        return coefficients.astype(np.float32).T @ self.right.astype(np.float32)


def _gains(series: Series) -> Double:
    """Return the relative noise of each ray, squared, over its median, (C, M)."""
    light = np.sqrt(np.square(series.radiance, dtype=np.float64).mean(axis=0))
    light = np.maximum(light, 1e-3 * max(float(light.max(initial=0)), TINY))
    spread = series.variance.mean(axis=0, dtype=np.float64)
    if not spread.any():  # of unknown noise: the same relative noise for every ray
        return np.ones_like(light)
    gain = np.maximum(spread, 1e-3 * spread.mean()) / np.square(light)
    return np.asarray(gain / np.median(gain))


def _spread(patterns: Double, shape: tuple[int, ...], scale: float) -> Double:
    """Return the patterns (K, N) times the prior's correlation, of a width in projector pixels."""
    from scipy.ndimage import gaussian_filter

    spread = patterns
    if scale:
        images = patterns.reshape(len(patterns), *RayDomain(shape).stack_shape)
        sigma = (0, 0, scale, scale)
        filtered = gaussian_filter(images, sigma, mode="constant", truncate=6)
        impulse = np.zeros(tuple(2 * int(6 * scale) + 1 for _ in range(2)))
        impulse[impulse.shape[0] // 2, impulse.shape[1] // 2] = 1
        peak = gaussian_filter(impulse, scale, mode="constant", truncate=6).max()
        spread = filtered.reshape(patterns.shape) / peak
    return np.asarray(spread + patterns.sum(axis=1, keepdims=True))
