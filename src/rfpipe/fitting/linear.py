"""Regularised least squares: the transport of each camera ray from all pictures.

A row t of T is taken for a Gaussian process over the projector's rays: its entries share a mean,
are equally large and, over some distance, alike. With patterns P, pictures ``y = P t`` of variance
V and the prior's covariance K, ``t = K P^T (P K P^T + V / s)^-1 y``, s the prior's variance. One
eigenvalue decomposition serves all rays, of coloured patterns those of one channel. Where V is
known, the distance, and s beside the brightness of a ray, are those under which the pictures are
most probable. Where it isn't, complete patterns are solved directly, and for others
cross-validation chooses. Where the patterns are complete and noise is small, all of them come to
the direct solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.fitting.series import Float, Series
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.base import Transport
from rfpipe.transport.low_rank import LowRankTransport

Double = NDArray[np.float64]

# Noise to signal, squared, among which the most probable is sought.
_RIDGES: Double = np.logspace(-10, 2, 25)
# Eigenvalues below this part of the largest one are rounding; so is noise below it.
_ROUNDING = 1e-13
_TINY = float(np.finfo(np.float32).tiny)
# By this factor a picture that doesn't fit is predicted worse than the median one, squared; its
# inverse is its least error. In simulation, with half more random patterns than rays, good pictures
# reached 2.3 times the median, and exchanged, copied, turned and shuffled ones 168 times and more.
_STRANGE = 10.0


def solve_linear(series: Series, rows: list[dict[str, Any]]) -> Transport:
    """Return the transport with the most probable rows; `rows` is its table of levels."""
    factors = [pair for lit_alike in series.by_light() for pair in _solved(lit_alike)]
    shapes = series.camera_shape, series.projector_shape
    channels, terms = len(factors), max(len(left) for left, _ in factors)
    rays, lights = (factor.shape[1] for factor in factors[0])
    if terms * (rays + lights) >= rays * lights:
        matrix = np.stack([left.T @ right for left, right in factors])
        return DenseTransport(*shapes, channels, rows, {"matrix": matrix})
    left, right = (
        np.stack([np.pad(factor, ((0, terms - len(factor)), (0, 0))) for factor in side])
        for side in zip(*factors, strict=True)
    )
    strengths = np.ones((channels, terms), np.float32)
    arrays = {"left": left, "right": right, "strengths": strengths}
    return LowRankTransport(*shapes, channels, rows, arrays)


def _solved(series: Series) -> list[tuple[Float, Float]]:
    """Return each channel's factors, (terms, M) and (terms, N), of what is lit alike."""
    weights, gain = _weights(series), _gains(series)
    if not series.variance.any() and series.is_complete:
        return _Basis.of(series, weights, 0.0).solved(series, weights, gain, _ROUNDING)
    basis, ridge, _ = _most_probable(series, weights, gain)
    return basis.solved(series, weights, gain, ridge)


def strange_pictures(series: Series) -> NDArray[np.intp]:
    """Return the numbers of pictures that the others predict far worse than most, the worst first.

    With ``C = (P K P^T + V / s)^-1``, a picture is off by ``(C y)_k / C_kk`` from what the others
    predict, with variance ``1 / C_kk``. Of coloured patterns, channel by channel.
    """
    strange = np.concatenate([_strange(lit_alike) for lit_alike in series.by_light()])
    return strange[np.sort(np.unique(strange, return_index=True)[1])]


def _strange(series: Series) -> NDArray[np.intp]:
    """Return `strange_pictures` of what is lit alike."""
    basis, ridge, observed = _most_probable(series, _weights(series), _gains(series))
    count, vectors = len(observed), basis.vectors
    inverse = (vectors / (basis.values + ridge)) @ vectors.T
    inverse += (np.eye(count) - vectors @ vectors.T) / ridge
    pictures, own = observed.reshape(count, -1), np.diag(inverse)
    wrong, light = (np.square(each).sum(axis=1) for each in (inverse @ pictures, pictures))
    score, is_off = wrong / own, wrong > light * np.square(own / _STRANGE)
    worst = np.argsort(-score)
    strange = is_off & (score > _STRANGE * np.median(score))
    return np.asarray(worst[strange[worst]])


def _weights(series: Series) -> Double:
    """Return the pictures' weights: one over their deviations, relative to the mean's."""
    variance = series.variance.mean(axis=(1, 2), dtype=np.float64)
    if not variance.any():
        return np.ones(len(variance))
    # a picture of no noise at all is one of which nothing was known
    return np.asarray(1 / np.sqrt(np.maximum(variance / variance.mean(), 1e-3)))


def _most_probable(series: Series, weights: Double, gain: Double) -> tuple[_Basis, float, Double]:
    """Return the prior's basis and ridge, and the weighted pictures (K, C, m) that chose them."""
    rays = series.radiance.shape[2]  # some of them, evenly spread, choose the prior
    looked = np.unique(np.linspace(0, rays - 1, min(rays, 512)).astype(np.int64))
    observed = series.radiance[:, :, looked].astype(np.float64) * weights[:, None, None]
    spread = series.variance[:, :, looked] * np.square(weights)[:, None, None]
    noise = spread.mean(axis=0, dtype=np.float64)
    longest = max(RayDomain(series.projector_shape).image_shape)
    fits = []
    for scale in [0.0, *(2.0**power for power in range(8) if 2 ** (power + 1) <= longest)]:
        basis = _Basis.of(series, weights, scale)
        scores = basis.scores(observed, gain[:, looked], noise)
        # cross-validation takes the least ridge whose score is about the best one's
        index = int(np.argmax(scores <= (1 if noise.any() else 1.02) * scores.min()))
        fits.append((float(scores[index]), basis, float(_RIDGES[index])))
    _, basis, ridge = min(fits, key=lambda each: each[0])
    return basis, ridge, observed


@dataclass(frozen=True, eq=False)
class _Basis:
    """Patterns under a prior, decomposed.

    Attributes
    ----------
    values : ndarray of float64, shape (R,)
        Of the pictures' covariance under the prior, relative to the largest; not zero.
    vectors : ndarray of float64, shape (K, R)
    right : ndarray of float64, shape (R, N)
    """

    values: Double
    vectors: Double
    right: Double

    @classmethod
    def of(cls, series: Series, weights: Double, scale: float) -> _Basis:
        """Decompose weighted patterns under a prior of one scale."""
        patterns = series.patterns[:, 0].astype(np.float64) * weights[:, None]
        spread = _spread(patterns, series.projector_shape, scale)
        values, vectors = np.linalg.eigh(patterns @ spread.T)
        largest = max(float(values[-1]), np.finfo(np.float64).tiny)
        used = values > _ROUNDING * largest
        values, vectors = values[used][::-1], vectors[:, used][:, ::-1]
        return cls(values / largest, vectors, (vectors.T @ spread) / largest)

    def scores(self, observed: Double, gain: Double, noise: Double) -> Double:
        """Return how bad each ridge is for pictures (K, C, m) of noise (C, m).

        How improbable they are where the noise is known; else, the generalised cross-validation
        score.
        """
        along = np.square(np.einsum("kr,kcm->rcm", self.vectors, observed, optimize=True))
        light = np.square(observed).sum(axis=0)
        rest = np.maximum(light - along.sum(axis=0), 0)
        silent = len(self.vectors) - len(self.values)
        shining, is_known = noise > 0, bool(noise.any())
        scores = np.empty(len(_RIDGES))
        for index, ridge in enumerate(_RIDGES):
            penalty = ridge * gain
            variance = self.values[:, None, None] + penalty
            if is_known:
                unit = np.where(shining, noise, 1) / penalty
                misfit = (along / variance).sum(axis=0) + (rest / penalty if silent else 0)
                logs = np.log(variance).sum(axis=0) + silent * np.log(penalty)
                score = len(observed) * np.log(unit) + logs + misfit / unit
                scores[index] = float(score[shining].sum())
            else:
                share = penalty / variance
                missed = (np.square(share) * along).sum(axis=0) + rest
                free = np.square(share.sum(axis=0) + silent)
                scores[index] = float((missed / free / np.maximum(light, _TINY)).mean())
        return scores

    def solved(
        self, series: Series, weights: Double, gain: Double, ridge: float
    ) -> list[tuple[Float, Float]]:
        """Return the solution at a ridge: each channel's factors, (terms, M) and (terms, N)."""
        factors, right = [], self.right.astype(np.float32)
        for channel in range(series.channels):
            inverse = 1 / (self.values[:, None] + ridge * gain[channel])
            observed = series.radiance[:, channel].astype(np.float64) * weights[:, None]
            left = inverse * (self.vectors.T @ observed)
            factors.append((left.astype(np.float32), right))
        return factors


def _gains(series: Series) -> Double:
    """Return the variance of each ray's pictures over its squared brightness, (C, M), of mean 1."""
    light = np.sqrt(np.square(series.radiance, dtype=np.float64).mean(axis=0))
    light = np.maximum(light, 1e-3 * max(float(light.max()), _TINY))
    spread = series.variance.mean(axis=0, dtype=np.float64)
    if not spread.any():  # nothing is known: as many per cent of every ray
        return np.ones_like(light)
    gain = np.maximum(spread, 1e-3 * spread.mean()) / np.square(light)
    return np.asarray(gain / np.median(gain))


def _spread(patterns: Double, shape: tuple[int, ...], scale: float) -> Double:
    """Return the patterns (K, N) times the prior's covariance."""
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
