"""Whether a coaxial rig's light transport is symmetric enough for symmetric photography."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.calibration.base import Findings, Verdict
from rfpipe.errors import CaptureError
from rfpipe.photometry import MergeOptions
from rfpipe.provenance import generator
from rfpipe.rigs import BLACK_LEVEL_KEY, FLOODLIT_KEY, Rig

__all__ = ["Scale", "Symmetry", "measure_symmetry", "random_signs", "symmetry_findings",
           "take_symmetry"]  # fmt: skip

Double = NDArray[np.float64]

SCALES = (1, 4, 16)
"""Sides, in rays, of the patches that random patterns are made of."""

CONFIDENCE = 2.0


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


@dataclass(frozen=True, eq=False)
class Symmetry:
    """What a symmetry check found; `predicted` is the largest over its scales."""

    scales: tuple[Scale, ...]

    @property
    def worst(self) -> Scale:
        """The scale of the largest predicted error."""
        return max(self.scales, key=lambda scale: scale.predicted)


def random_signs(shape: tuple[int, ...], side: int, count: int, seed: int) -> Double:
    """Return patterns of patches of random sign, (count, *shape), values -1 and 1."""
    views, height, width = RayDomain(shape).stack_shape
    random = generator(seed, side)
    patches = (count, views, -(-height // side), -(-width // side))
    coarse = random.integers(0, 2, patches) * 2.0 - 1
    fine = coarse.repeat(side, axis=-2).repeat(side, axis=-1)
    return np.asarray(fine[..., :height, :width]).reshape(count, *shape)


def take_symmetry(
    rig: Rig, count: int, black_count: int, seed: int = 0
) -> tuple[Double, Double, list[_Pictures]]:
    """Take what `measure_symmetry` needs.

    Returns
    -------
    floodlit, variance : ndarray of float64, shape (N, C)
    pictures : list
        For each side of patches, from single rays on.
    """
    shape = rig.projector_shape

    def merged(patterns: NDArray[np.float32], level: int) -> tuple[Double, Double]:
        found: list[tuple[Any, Any]] = []
        for index, pattern in enumerate(patterns):
            result = merge(rig.capture(pattern[None], [(level, index)]), index)
            found.append((result.radiance[0], result.variance[0]))
        radiance, variance = (
            np.stack(part).astype(np.float64) for part in zip(*found, strict=True)
        )
        flat = (len(patterns), -1, rig.channels)
        return radiance.reshape(flat), variance.reshape(flat)

    total = 0.0
    off = np.zeros((1, *shape), np.float32)
    for index in range(black_count):
        total = total + rig.capture(off, [(BLACK_LEVEL_KEY, index)])[0].astype(np.float64)
    black = np.asarray(total / black_count, np.float32)
    merge = rig.sensor.merging(black, MergeOptions(black_count))
    on, noise = merged(np.ones((black_count, *shape), np.float32), FLOODLIT_KEY)
    floodlit, variance = on.mean(axis=0), noise.mean(axis=0) / black_count
    pictures = []
    for side in SCALES:
        if side > 1 and side * 2 > max(RayDomain(shape).image_shape):
            continue
        signs = random_signs(shape, side, count, seed)
        radiance, spread = merged((signs > 0).astype(np.float32), side)
        of_signs = 2 * radiance - floodlit, 4 * spread + variance
        pictures.append(_Pictures(side, signs.reshape(count, -1), *of_signs, radiance, spread))
    return floodlit, variance, pictures


def measure_symmetry(floodlit: Double, variance: Double, pictures: list[_Pictures]) -> Symmetry:
    """Measure asymmetry from pictures under random patterns.

    Parameters as `take_symmetry` returns.

    Raises
    ------
    CaptureError
        When there are fewer than two patterns of a scale.

    Notes
    -----
    With signs s and pictures ``c(s) = T s = 2 T p - T 1``, each pair gives
    ``s2^T T s1 - s1^T T s2 = s2^T K s1`` with ``K = T - T^T``. With independent signs for each ray
    in s2 its mean square is ``||K s1||^2``, whatever s1: of patches, or all ones. Symmetric
    photography stores ``T - K / 2``, so that a picture under ``p = (1 + s1) / 2`` is off by
    ``K p / 2``. The noise's own share of the mean squares is subtracted.
    """
    fine = pictures[0]
    if min(len(one.signs) for one in pictures) < 2:
        raise CaptureError("one pattern of patches of a size makes no pair; expected 2 or more")
    ahead = np.einsum("in,nc->ic", fine.signs, floodlit)
    noise = fine.noise.sum(axis=1) + variance.sum(axis=0)
    of_ones = _Square.of(ahead - fine.images.sum(axis=1), noise, len(fine.signs))
    return Symmetry(tuple(_scale(one, fine, of_ones) for one in pictures))


@dataclass(frozen=True, eq=False)
class _Pictures:
    """Pictures of random signs (count, N) of one size of patches, and their noise, (count, N, C).

    Radiance and spread are those under the pattern that is 1 where the sign is, else 0.
    """

    side: int
    signs: Double
    images: Double
    noise: Double
    radiance: Double
    spread: Double


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


def _scale(coarse: _Pictures, fine: _Pictures, of_ones: _Square) -> Scale:
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
    scale = 16 * float(light.sum(axis=1).mean())
    predicted, error = _root(
        (of_ones.value + of_signs.value) / scale, np.hypot(of_ones.error, of_signs.error) / scale
    )
    size = float(np.sqrt(np.square(forward).sum(axis=1).mean()))
    return Scale(
        coarse.side,
        forward.sum(axis=1) / size,
        backward.sum(axis=1) / size,
        np.sqrt(noise.sum(axis=1)) / size,
        predicted,
        error,
    )


def symmetry_findings(symmetry: Symmetry, tolerance: float) -> Findings:
    """Return the step's findings, with a verdict whether the predicted error is accepted.

    Parameters
    ----------
    symmetry : Symmetry
    tolerance : float
        Relative error of a relit picture that the rig is to stay below.
    """
    worst = symmetry.worst
    low = worst.predicted - CONFIDENCE * worst.predicted_error
    high = worst.predicted + CONFIDENCE * worst.predicted_error
    found = (
        f"asymmetry alone makes errors of {worst.predicted:.2%} +- {worst.predicted_error:.2%} in "
        f"pictures relit with patches of {worst.side} rays, {tolerance:.1%} accepted"
    )
    if high <= tolerance:
        verdict = Verdict("good", f"Good enough for symmetric photography: {found}.")
    elif low > tolerance:
        verdict = Verdict(
            "poor",
            f"Not good enough for symmetric photography: {found}. Largest at one ray: align the "
            "two devices' centres, or focus. At patches of many rays: flare, or unequal vignetting "
            "of projector and camera. Dual photography doesn't need symmetry.",
        )
    else:
        verdict = Verdict(
            "unknown", f"The noise can't tell: {found}. Use more patterns, or longer exposures."
        )
    facts = {
        "tolerance": tolerance,
        "scales": [
            {
                "side_rays": scale.side,
                "pairs": len(scale.forward),
                "predicted_error": scale.predicted,
                "standard_error": scale.predicted_error,
            }
            for scale in symmetry.scales
        ],
    }
    arrays = {
        f"{name}_{scale.side}": getattr(scale, name)
        for scale in symmetry.scales
        for name in ("forward", "backward", "error")
    }
    return Findings(verdict, facts, arrays)


def _root(square: float, error: float) -> tuple[float, float]:
    """Return the root of a square that may be below zero by its noise, and its error."""
    root = float(np.sqrt(max(square, 0.0)))
    # far from zero half the relative error; near it, what the error alone would be the square of
    return root, float(min(np.sqrt(error), error / max(2 * root, 1e-300)))
