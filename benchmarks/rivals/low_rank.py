"""Optical low rank: the range of T from pictures under random signs.

M. O'Toole and K. N. Kutulakos, *Optical computing for fast light transport analysis*, SIGGRAPH
Asia 2010; N. Halko, P. G. Martinsson and J. A. Tropp, *Finding structure with randomness*, SIAM
Review 53 (2011), section 5.5; C. Bekas, E. Kokiopoulou and Y. Saad, *An estimator for the diagonal
of a matrix*, Applied Numerical Mathematics 57 (2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil, log2, sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmarks.rivals.signs import as_light, random_signs, trimmed_mean
from rfpipe.array_types import Double, Float
from rfpipe.blocks import RayDomain
from rfpipe.methods.base import (
    MEMORY_BYTES,
    ErrorOptions,
    Forecast,
    LevelImages,
    Method,
    StateArrays,
    check_rays,
)
from rfpipe.methods.images import planar_batches, rounding
from rfpipe.methods.states import MethodState, level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.low_rank import LowRankTransport

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
    images : ndarray of float32, shape (C, rank, rays)
        The images u, of norm 1; zeros where a channel has fewer terms than another.
    strengths : ndarray of float32, shape (C, rank)
        The factors s, the largest magnitude first.
    """

    diagonal: Float
    images: Float
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
    images = known.images[channel]
    products: Float = vectors * known.diagonal[channel]
    products += ((vectors @ images.T) * known.strengths[channel]) @ images
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
    range_terms = [
        _fit_channel(columns, of_channel.T.astype(np.float64), variance)
        for of_channel, variance in zip(products, noise, strict=True)
    ]
    rank = max(len(strengths) for _, _, strengths in range_terms)
    images = np.zeros((len(range_terms), rank, vectors.shape[1]), np.float32)
    strengths = np.zeros((len(range_terms), rank), np.float32)
    for channel, (_, basis, own) in enumerate(range_terms):
        images[channel, : len(own)], strengths[channel, : len(own)] = basis.T, own
    return Fit(
        np.array([diagonal for diagonal, _, _ in range_terms], np.float32), images, strengths
    )


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

    The range is spanned by the products' singular vectors above noise; within it, the symmetric
    core S of least squares ``|U S U^T X - Y|``, weighted by the products' noise.
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


_SEED = 2010
# Patterns of the first round of random signs; each round doubles them all.
_FIRST_ROUND = 16
# Largest numbers of patterns, by default and on request: the time of a fit grows with their square.
DEFAULT_MOST, _MOST = 512, 4096


@dataclass(frozen=True)
class Round:
    """Pictures of a level.

    Attributes
    ----------
    images : ndarray of float32, shape (C, patterns, rays)
        ``T q`` for signed patterns q, all ones at level 0.
    noise : ndarray of float64, shape (C, patterns)
        Mean variance of a pixel of each.
    """

    images: Float
    noise: NDArray[np.float64]


@dataclass(frozen=True)
class LowRankState(MethodState):
    """State of an optical low-rank acquisition.

    Level 0 is the floodlit image, each other one a round of random signs. A round's row has the
    ``estimated_error`` of the fit before it, relative to the images' norm.

    Attributes
    ----------
    rounds : sequence of Round
        One a level.
    fit : Fit
        To all of them.
    done : bool
        Whether the acquisition is complete.
    """

    options: ErrorOptions
    fit: Fit = field(kw_only=True)
    rounds: tuple[Round, ...] = ()
    done: bool = False

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the last round, the fit and the table of levels."""
        last = self.rounds[-1]
        arrays = {
            "round_images": last.images,
            "round_noise": last.noise,
            "left": self.fit.images,
            "strengths": self.fit.strengths,
            "diagonal": self.fit.diagonal,
        }
        return StateArrays(arrays, {"rows": list(self.rows), "done": self.done})

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state after the last of the levels."""
        if not levels:
            return start
        last = levels[-1]
        return replace(
            start,
            rows=tuple(last.attributes["rows"]),
            done=last.attributes["done"],
            rounds=tuple(
                Round(level.arrays["round_images"], level.arrays["round_noise"]) for level in levels
            ),
            fit=Fit(*(last.arrays[name] for name in ("diagonal", "left", "strengths"))),
        )

    @property
    def shown(self) -> int:
        """Patterns shown so far."""
        return sum(each.images.shape[1] for each in self.rounds)


class LowRank(Method[LowRankState]):
    """A randomised range finder that computes in light, as a `Method`.

    The images of each round of random signs first test the fit to those before it, which has not
    seen them. It ends when that error is below ``target_error`` or within noise, or at
    ``patterns``.

    The published methods have no diagonal. On a coaxial rig direct light is one, of full rank, and
    without it hundreds of patterns leave nine tenths of the light unexplained: it is estimated
    from the same pictures.
    """

    name = "low_rank"
    title = "Optical low rank"
    colour = "#b08a1e"
    marker = "P"
    needs_coaxial_rig = True
    estimates_error = True
    Options = ErrorOptions
    trades = "patterns"
    trials = (50, 100, 200, 500)

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> Forecast:
        """Forecast the number of the options, or the largest number without one."""
        check_rays(self, camera, projector)
        patterns = min(projector.size, options.patterns or DEFAULT_MOST)
        return self.forecast_of(camera, channels, patterns, patterns)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> LowRankState:
        """Return the state before the floodlit image."""
        check_rays(self, camera, projector)
        fit = start_fit(channels, camera.size)
        return LowRankState(camera, projector, channels, options, fit=fit)

    def next_schedule(self, state: LowRankState) -> Schedule | None:
        """Show the floodlit pattern, then in each round as many random signs as before it."""
        shape = state.projector.shape
        if state.level == 0:
            return Schedule.floodlit(shape)
        limit = min(state.options.patterns or DEFAULT_MOST, _MOST)
        count = min(_probes(state.level), limit - state.shown)
        if state.done or count <= 0 or state.level >= _level_count(state.projector.size):
            return None
        weights = as_light(_signs(state.projector, state.level, count), shape)
        return Schedule(state.level, shape, count, weights=weights)

    def refine(
        self, state: LowRankState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> LowRankState:
        """Test the fit on the round's images, then fit it to all of them."""
        count = images.schedule.count
        signed, noise = _read(state, images)
        level = state.level
        done, counts = False, {}
        if level:
            signs = _signs(state.projector, level, count)
            estimate, within_noise = _held_out(state.fit, signs, signed, noise)
            counts = {"estimated_error": estimate}
            done = within_noise or estimate <= state.options.target_error
        new = Round(signed, noise)
        fitted = _fit_all(state, [*state.rounds, new])
        rank = fitted.strengths.shape[1]
        row = level_row(level, count, nodes=1, rank1=rank, scalar=state.projector.size, **counts)
        return replace(
            state, rows=(*state.rows, row), rounds=(*state.rounds, new), fit=fitted, done=done
        )

    def transport(self, state: LowRankState) -> LowRankTransport:
        """Return the diagonal and the terms, the strongest first."""
        arrays = {
            "left": state.fit.images,
            "strengths": state.fit.strengths,
            "diagonal": state.fit.diagonal,
        }
        shape = state.projector.shape
        return LowRankTransport(shape, shape, state.channels, list(state.rows), arrays)


def _level_count(rays: int) -> int:
    """Number of rounds that make as many patterns as rays, and the floodlit level."""
    rays = min(max(rays, _FIRST_ROUND), _MOST)
    return 2 + ceil(log2(rays / _FIRST_ROUND))


def _probes(level: int) -> int:
    """Return the number of random sign patterns of a round; rounds are levels from 1."""
    return _FIRST_ROUND << max(level - 2, 0)


def _signs(domain: RayDomain, level: int, count: int) -> Float:
    """Return a level's signed patterns, float32 (count, rays)."""
    if level == 0:
        return np.ones((count, domain.size), np.float32)
    return random_signs(count, domain.size, _SEED, level)


def _read(state: LowRankState, images: LevelImages) -> tuple[Float, NDArray[np.float64]]:
    """Read pictures of signed patterns from a level, (C, P, rays), and their noise, (C, P)."""
    count, rays, channels = images.schedule.count, state.projector.size, state.channels
    signed = np.empty((channels, count, rays), np.float32)
    noise = np.empty((channels, count))
    for part, radiance, variance in planar_batches(images, channels, rays):
        signed[:, part], noise[:, part] = radiance, trimmed_mean(variance)
    if state.level:
        signed = 2 * signed - state.rounds[0].images
        # the floodlit image's noise is common to all, and the least of all by far; not its rounding
        noise = 4 * noise + rounding(state.rounds[0].images).mean(axis=-1, dtype=np.float64)
    return signed, noise


def _held_out(
    known: Fit, signs: Float, signed: Float, noise: NDArray[np.float64]
) -> tuple[float, bool]:
    """Return the relative error of a fit on images that it has not seen, and if it is noise."""
    residual = np.stack(
        [signed[c] - relit(known, c, signs) for c in range(len(signed))], dtype=np.float64
    )
    squares = float(np.square(residual).sum())
    expected = float(noise.sum()) * signs.shape[1]
    energy = float(np.square(signed, dtype=np.float64).sum())
    excess = squares - expected
    within_noise = excess <= 3 * sqrt(2 / residual.size) * expected
    return sqrt(max(excess, 0.0) / energy) if energy else 0.0, within_noise


def _fit_all(state: LowRankState, rounds: Sequence[Round]) -> Fit:
    counts = [each.images.shape[1] for each in rounds]
    signs = np.concatenate([_signs(state.projector, level, n) for level, n in enumerate(counts)])
    signed = np.concatenate([each.images for each in rounds], axis=1)
    return fit(signs, signed, np.concatenate([each.noise for each in rounds], axis=1))
