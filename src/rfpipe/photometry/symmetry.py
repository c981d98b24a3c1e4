"""Whether light goes from camera to projector as it comes: reciprocity of a coaxial rig (2.10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError
from rfpipe.provenance import generator

__all__ = ["CONFIDENCE", "Pictures", "Scale", "Symmetry", "measure_symmetry", "random_signs"]

Double = NDArray[np.float64]

_LEAST = float(np.finfo(np.float64).tiny)  # where there is no light at all

CONFIDENCE = 2.0
"""Standard errors that a verdict leaves to chance."""


@dataclass(frozen=True, eq=False)
class Scale:
    """Asymmetry for patterns of patches of one size.

    Attributes
    ----------
    side : int
        Rays a side of the patches.
    forward, backward, error : ndarray of float64, shape (pairs,)
        ``p2^T T p1`` and ``p1^T T p2`` over their RMS, p1 of such patches and p2 of single rays;
        the standard error of their difference by the noise.
    predicted, predicted_error : float
        Relative error that asymmetry brings to a picture relit under such patterns; standard error.
    """

    side: int
    forward: Double
    backward: Double
    error: Double
    predicted: float
    predicted_error: float

    @property
    def least(self) -> float:
        """The error that is there all but surely."""
        return self.predicted - CONFIDENCE * self.predicted_error


@dataclass(frozen=True, eq=False)
class Symmetry:
    """What a symmetry check found; `predicted` is the largest over its scales."""

    scales: tuple[Scale, ...]

    @property
    def worst(self) -> Scale:
        """The scale of the largest predicted error."""
        return max(self.scales, key=lambda scale: scale.predicted)


@dataclass(frozen=True, eq=False)
class Pictures:
    """Pictures under random patterns, 1 where a sign is positive and else 0, and their noise.

    Attributes
    ----------
    side : int
        Rays a side of the patches that share a sign.
    signs : ndarray of float64, shape (count, N)
    images, noise : ndarray of float64, shape (count, N, C)
        What the signs themselves would show, negative light included, and its variance.
    radiance, spread : ndarray of float64, shape (count, N, C)
        What the patterns show, and its variance.
    """

    side: int
    signs: Double
    images: Double
    noise: Double
    radiance: Double
    spread: Double

    @classmethod
    def of(
        cls, signs: Double, taken: tuple[Double, Double], floodlit: tuple[Double, Double], side: int
    ) -> Pictures:
        """Make them of radiance and variance, (count, N, C), and those of the floodlit image."""
        radiance, spread = taken
        images, noise = 2 * radiance - floodlit[0], 4 * spread + floodlit[1]
        return cls(side, signs.reshape(len(signs), -1), images, noise, radiance, spread)


def random_signs(shape: tuple[int, ...], side: int, count: int, seed: int) -> Double:
    """Return patterns of patches of random sign, (count, *shape), values -1 and 1."""
    views, height, width = RayDomain(shape).stack_shape
    random = generator(seed, side)
    patches = (count, views, -(-height // side), -(-width // side))
    coarse = random.integers(0, 2, patches) * 2.0 - 1
    fine = coarse.repeat(side, axis=-2).repeat(side, axis=-1)
    return np.asarray(fine[..., :height, :width]).reshape(count, *shape)


def measure_symmetry(floodlit: Double, variance: Double, pictures: list[Pictures]) -> Symmetry:
    """Measure asymmetry from pictures under random patterns.

    Parameters as `take_symmetry` returns.

    Raises
    ------
    CaptureError
        When there are fewer than three patterns of a scale.

    Notes
    -----
    With signs s and pictures ``c(s) = T s = 2 T p - T 1``, each pair gives
    ``s2^T T s1 - s1^T T s2 = s2^T K s1`` with ``K = T - T^T``. With independent signs for each ray
    in s2 its mean square is ``||K s1||^2``, whatever s1: of patches, or all ones. Symmetric
    photography stores ``T - K / 2``, so that a picture under ``p = (1 + s1) / 2`` is off by
    ``K p / 2``. The noise's own share of the mean squares is subtracted.
    """
    fine = pictures[0]
    if min(len(one.signs) for one in pictures) < 3:
        raise CaptureError(
            "fewer than three patterns of patches of a size make no two pairs; expected 3 or more"
        )
    ahead = np.einsum("in,nc->ic", fine.signs, floodlit)
    noise = fine.noise.sum(axis=1) + variance.sum(axis=0)
    of_ones = _Square.of(ahead - fine.images.sum(axis=1), noise, len(fine.signs))
    return Symmetry(tuple(_scale(one, fine, of_ones) for one in pictures))


@dataclass(frozen=True)
class _Square:
    """A mean square, summed over channels, with its standard error; without the noise's share."""

    value: float
    error: float

    @classmethod
    def of(cls, difference: Double, noise: Double, count: int) -> _Square:
        """Estimate it from pairs (n, C), which `count` independent patterns were made of."""
        squares = (difference**2 - noise).sum(axis=1)
        # where nothing but noise is left, its squares spread by twice their variance
        least = np.sqrt(2 * np.square(noise).sum(axis=1).mean())
        spread = max(float(squares.std(ddof=1)), float(least))
        return cls(float(squares.mean()), spread / float(np.sqrt(min(len(squares), count))))


def _scale(coarse: Pictures, fine: Pictures, of_ones: _Square) -> Scale:
    """Measure patterns of one size of patches against those of single rays."""
    forward = np.einsum("jn,inc->ijc", fine.signs, coarse.images)
    backward = np.einsum("in,jnc->ijc", coarse.signs, fine.images)
    noise = coarse.noise.sum(axis=1)[:, None] + fine.noise.sum(axis=1)[None]
    count = len(coarse.signs)
    chosen = np.ones(forward.shape[:2], bool)
    if coarse is fine:
        chosen = np.triu(chosen, 1)  # each pair once
    forward, backward, noise = (values[chosen] for values in (forward, backward, noise))
    of_signs = _Square.of(forward - backward, noise, count)
    light = np.square(coarse.radiance).sum(axis=1) - coarse.spread.sum(axis=1)
    scale = max(16 * float(light.sum(axis=1).mean()), _LEAST)
    predicted, error = _root(
        (of_ones.value + of_signs.value) / scale, np.hypot(of_ones.error, of_signs.error) / scale
    )
    size = max(float(np.sqrt(np.square(forward).sum(axis=1).mean())), _LEAST)
    return Scale(
        coarse.side,
        forward.sum(axis=1) / size,
        backward.sum(axis=1) / size,
        np.sqrt(noise.sum(axis=1)) / size,
        predicted,
        error,
    )


def _root(square: float, error: float) -> tuple[float, float]:
    """Return the root of a square that may be below zero by its noise, and its error."""
    root = float(np.sqrt(max(square, 0.0)))
    # far from zero half the relative error; near it, what the error alone would be the square of
    return root, float(min(np.sqrt(error), error / max(2 * root, _LEAST)))
