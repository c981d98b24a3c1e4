"""Optical low rank: the range of T from pictures under random signs.

M. O'Toole and K. N. Kutulakos, *Optical computing for fast light transport analysis*, SIGGRAPH
Asia 2010; N. Halko, P. G. Martinsson and J. A. Tropp, *Finding structure with randomness*, SIAM
Review 53 (2011), section 5.5; C. Bekas, E. Kokiopoulou and Y. Saad, *An estimator for the diagonal
of a matrix*, Applied Numerical Mathematics 57 (2007).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, log2, sqrt

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, ErrorOptions, Float, LevelImages
from rfpipe.methods.images import planar_batches, rounding
from rfpipe.methods.rivals.low_rank_fit import Fit, fit, relit, start_fit
from rfpipe.methods.rivals.signs import as_light, random_signs, trimmed_mean
from rfpipe.methods.states import MethodState, Packing, PackingMethod, level_row
from rfpipe.patterns import Schedule
from rfpipe.transport.low_rank import LowRankTransport

_SEED = 2010
# Patterns of the first round of random signs; each round doubles them all.
_FIRST_ROUND = 16
# So many patterns at most, and where they are asked for: a fit's time grows with their square.
OWN_MOST, _MOST = 512, 4096


@dataclass(frozen=True)
class LowRankState(MethodState):
    """The state of an optical low-rank acquisition, beside what all states have.

    Level 0 is the floodlit image, each other one a round of random signs. A round's row has the
    ``estimated_error`` of the fit before it, relative to the images' norm.

    Attributes
    ----------
    images : tuple of ndarray of float32, shape (C, patterns, rays)
        ``T q`` for each level's signed patterns q, all ones at level 0.
    noise : tuple of ndarray of float64, shape (C, patterns)
        Mean variance of a pixel of each.
    fit : Fit
        To all of them.
    done : bool
        Whether no more patterns are asked for.
    """

    options: ErrorOptions
    fit: Fit
    images: tuple[Float, ...] = ()
    noise: tuple[NDArray[np.float64], ...] = ()
    done: bool = False

    @property
    def shown(self) -> int:
        """Patterns shown so far."""
        return sum(images.shape[1] for images in self.images)


class LowRank(PackingMethod[LowRankState]):
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
    packing = Packing(("level", "done", "rows"), groups={"fit": ""}, latest=("images", "noise"))

    def expected_patterns(
        self, camera: RayDomain, projector: RayDomain, options: ErrorOptions
    ) -> int:
        """Return the number that is asked for, or the most that it shows of itself."""
        return min(projector.size, options.patterns or OWN_MOST)

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the rounds that make as many patterns as rays, and the floodlit level."""
        self.check(camera, projector)
        rays = min(max(projector.size, _FIRST_ROUND), _MOST)
        return 2 + ceil(log2(rays / _FIRST_ROUND))

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> LowRankState:
        """Return the state before the floodlit image."""
        fit = start_fit(channels, camera.size)
        return LowRankState(camera, projector, channels, options, fit)

    def schedule(self, state: LowRankState) -> Schedule:
        """Show the floodlit pattern, then in each round as many random signs as before it."""
        shape = state.projector.shape
        if state.level == 0:
            return Schedule.floodlit(shape)
        limit = min(state.options.patterns or OWN_MOST, _MOST)
        count = 0 if state.done else min(_probes(state.level), max(limit - state.shown, 0))
        weights = as_light(_signs(state.projector, state.level, count), shape)
        return Schedule(state.level, shape, count, weights=weights)

    def refine(
        self, state: LowRankState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> LowRankState:
        """Test the fit on the round's images, then fit it to all of them."""
        count = images.schedule.count
        signed, noise = _read(state, images)
        level = state.level
        done, found = state.done or not count, {}
        if level and count:
            signs = _signs(state.projector, level, count)
            estimate, within_noise = _held_out(state.fit, signs, signed, noise)
            found = {"estimated_error": estimate}
            done = within_noise or estimate <= state.options.target_error
        state = replace(
            state, images=(*state.images, signed), noise=(*state.noise, noise), done=done
        )
        if count:
            state = replace(state, fit=_fit_all(state))
        rank = state.fit.strengths.shape[1]
        row = level_row(level, count, nodes=1, rank1=rank, scalar=state.projector.size, **found)
        return state.after(row)

    def transport(self, state: LowRankState) -> LowRankTransport:
        """Return the diagonal and the terms, the strongest first."""
        arrays = {
            "left": state.fit.left,
            "strengths": state.fit.strengths,
            "diagonal": state.fit.diagonal,
        }
        shape = state.projector.shape
        return LowRankTransport(shape, shape, state.channels, list(state.rows), arrays)


def _probes(level: int) -> int:
    """Return how many random signs a round shows; rounds are levels, from 1 on."""
    return _FIRST_ROUND << max(level - 2, 0)


def _signs(domain: RayDomain, level: int, count: int) -> Float:
    """Return a level's signed patterns, float32 (count, rays)."""
    if level == 0:
        return np.ones((count, domain.size), np.float32)
    return random_signs(count, domain.size, _SEED, level)


def _read(state: LowRankState, images: LevelImages) -> tuple[Float, NDArray[np.float64]]:
    """Read a level's images as those of signed patterns, (C, P, rays), and their noise, (C, P)."""
    count, rays, channels = images.schedule.count, state.projector.size, state.channels
    signed = np.empty((channels, count, rays), np.float32)
    noise = np.empty((channels, count))
    for part, radiance, variance in planar_batches(images, channels, rays):
        signed[:, part], noise[:, part] = radiance, trimmed_mean(variance)
    if state.level:
        signed = 2 * signed - state.images[0]
        # the floodlit image's noise is common to all, and the least of all by far; not its rounding
        noise = 4 * noise + rounding(state.images[0]).mean(axis=-1, dtype=np.float64)
    return signed, noise


def _held_out(
    known: Fit, signs: Float, signed: Float, noise: NDArray[np.float64]
) -> tuple[float, bool]:
    """Return the relative error of a fit on images that it has not seen, and if it is noise."""
    residual = np.stack(
        [signed[c] - relit(known, c, signs) for c in range(len(signed))], dtype=np.float64
    )
    found = float(np.square(residual).sum())
    expected = float(noise.sum()) * signs.shape[1]
    energy = float(np.square(signed, dtype=np.float64).sum())
    excess = found - expected
    within_noise = excess <= 3 * sqrt(2 / residual.size) * expected
    return sqrt(max(excess, 0.0) / energy) if energy else 0.0, within_noise


def _fit_all(state: LowRankState) -> Fit:
    counts = [images.shape[1] for images in state.images]
    signs = np.concatenate([_signs(state.projector, level, n) for level, n in enumerate(counts)])
    signed = np.concatenate(state.images, axis=1)
    return fit(signs, signed, np.concatenate(state.noise, axis=1))
