"""A symmetric matrix as a diagonal and a few terms, from its products with known vectors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float

Double = NDArray[np.float64]

# Products for each term that they determine. With fewer, the errors of the terms outgrow what the
# weakest of them explain: four were best, or next to it, from 16 to 512 products.
_PRODUCTS_A_TERM = 4
# Diagonal and terms are fitted in turn until the diagonal changes by so little of its variance.
_ROUNDS, _CONVERGED = 20, 0.1


@dataclass(frozen=True)
class Fit:
    """A symmetric matrix a channel, ``diag(d) + sum_r s_r u_r u_r^T``.

    Attributes
    ----------
    diagonal : ndarray of float32, shape (C, rays)
    left : ndarray of float32, shape (C, rank, rays)
        The images u, of norm 1; zeros where a channel has fewer terms than another.
    strengths : ndarray of float32, shape (C, rank)
        The factors s, the largest magnitude first.
    """

    diagonal: Float
    left: Float
    strengths: Float


def start_fit(channels: int, rays: int) -> Fit:
    """Return the fit before any product is known: zero."""
    return Fit(
        np.zeros((channels, rays), np.float32),
        np.zeros((channels, 0, rays), np.float32),
        np.zeros((channels, 0), np.float32),
    )


def relit(known: Fit, channel: int, vectors: Float) -> Float:
    """Return one channel's products with vectors (P, rays)."""
    left = known.left[channel]
    products: Float = vectors * known.diagonal[channel]
    products += ((vectors @ left.T) * known.strengths[channel]) @ left
    return products


def fit(vectors: Float, products: Float, noise: Double) -> Fit:
    """Fit a diagonal and terms to a symmetric matrix' products with known vectors.

    Parameters
    ----------
    vectors : ndarray of float32, shape (P, rays)
        The first is all ones; the others are independent random signs, -1 or 1.
    products : ndarray of float32, shape (C, P, rays)
    noise : ndarray of float64, shape (C, P)
        Mean variance of an entry of each product, above 0.

    Returns
    -------
    Fit
        With as many terms as stand out of the noise, and one for four products at most. With a
        single product all is taken to be diagonal.
    """
    if len(vectors) == 1:
        return replace(start_fit(len(products), vectors.shape[1]), diagonal=products[:, 0])
    columns = vectors.T.astype(np.float64)
    found = [
        _fit_channel(columns, of_channel.T.astype(np.float64), variance)
        for of_channel, variance in zip(products, noise, strict=True)
    ]
    rank = max(len(strengths) for _, _, strengths in found)
    left = np.zeros((len(found), rank, vectors.shape[1]), np.float32)
    strengths = np.zeros((len(found), rank), np.float32)
    for channel, (_, basis, own) in enumerate(found):
        left[channel, : len(own)], strengths[channel, : len(own)] = basis.T, own
    return Fit(np.array([diagonal for diagonal, _, _ in found], np.float32), left, strengths)


def _fit_channel(vectors: Double, products: Double, noise: Double) -> tuple[Double, Double, Double]:
    """Fit one matrix: its diagonal (rays,), images (rays, rank) and strengths (rank,)."""
    weights = 1 / np.sqrt(noise)
    signs, drawn = vectors[:, 1:], products[:, 1:]
    samples = signs * drawn
    for _ in range(_ROUNDS):
        diagonal = samples.mean(axis=1)
        basis, strengths = _terms(vectors, products - diagonal[:, None] * vectors, weights)
        # the signs of the other rays are random, so that their light averages away
        samples = signs * (drawn - basis @ (strengths[:, None] * (basis.T @ signs)))
        change = np.square(samples.mean(axis=1) - diagonal).sum()
        if change <= _CONVERGED * samples.var(axis=1).sum() / samples.shape[1]:
            break
    off = basis @ (strengths * basis.sum(axis=0))
    return _reconciled(samples, products[:, 0] - off), basis, strengths


def _reconciled(samples: Double, floodlit: Double) -> Double:
    """Join two estimates of a diagonal, each weighted by its variance.

    Parameters
    ----------
    samples : ndarray of float64, shape (rays, P)
        What each product with random signs says, which is right on average.
    floodlit : ndarray of float64, shape (rays,)
        What the terms leave of the floodlit image: of less noise, but with the terms' errors,
        which add up. What it differs more by than the samples' mean may is its own variance.
    """
    mean: Double = samples.mean(axis=1)
    own = float(samples.var(axis=1).mean()) / samples.shape[1]
    other = max(float(np.square(floodlit - mean).mean()) - own, 0.0)
    return mean if own == 0.0 else (other * mean + own * floodlit) / (own + other)


def _terms(vectors: Double, products: Double, weights: Double) -> tuple[Double, Double]:
    """Fit terms to products ``Y`` of vectors ``X``: orthonormal images and strengths.

    The range is that of the products' singular vectors above noise; within it, the symmetric core
    S of least squares ``|U S U^T X - Y|``, weighted by the products' noise.
    """
    rays, count = products.shape
    weighted = products * weights
    squares, mixtures = np.linalg.eigh(weighted.T @ weighted)
    # the largest singular value of noise alone, of variance 1
    above = squares > (np.sqrt(rays) + np.sqrt(count)) ** 2
    rank = min(int(np.count_nonzero(above)), count // _PRODUCTS_A_TERM, rays)
    basis, _ = np.linalg.qr(weighted @ mixtures[:, ::-1][:, :rank])
    seen = basis.T @ (vectors * weights)
    target = seen @ (weighted.T @ basis)
    scale, axes = np.linalg.eigh(seen @ seen.T)
    # S G + G S = target + target^T, in the axes of G
    core = axes.T @ (target + target.T) @ axes / (scale[:, None] + scale)
    strengths, turn = np.linalg.eigh(axes @ core @ axes.T)
    order = np.argsort(-np.abs(strengths))
    return basis @ turn[:, order], strengths[order]
