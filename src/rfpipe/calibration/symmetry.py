"""How far a rig is from coaxial: whether light goes from camera to projector as it comes (2.10).

By random patterns that are shown for that, or by the pictures of an acquisition themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.calibration.bench import Bench
from rfpipe.calibration.verdicts import Findings
from rfpipe.errors import CaptureError
from rfpipe.photometry.resampling import ResampledSensor, Resampling
from rfpipe.photometry.sensor import MergeOptions, Sensor
from rfpipe.provenance import generator
from rfpipe.rigs.layout import ProjectorLayout

Float = NDArray[np.float32]
Double = NDArray[np.float64]

CONFIDENCE = 2.0
"""Standard errors that a verdict leaves to chance."""

_LEAST = float(np.finfo(np.float64).tiny)  # where there is no light at all
_UNKNOWN = 0.5  # squared error that unknown pixels may seem to make, for their share
_WITNESSES = 24  # pictures that each new one is held against: chance has no say in so many


class Pictures(NamedTuple):
    """Radiance and variance (count, N, C) under random patterns (count, N), lit where a sign is 1.

    Patches of `side` x `side` rays share a sign.
    """

    side: int
    signs: Double
    radiance: Double
    variance: Double


Taken = tuple[Double, Double, list[Pictures]]
"""The floodlit image and its variance, (N, C), and pictures for each side of patches."""


class Scale(NamedTuple):
    """Asymmetry for patterns of patches of one size.

    Attributes
    ----------
    side : int
        Rays a side of the patches.
    predicted, predicted_error : float
        Relative error that asymmetry brings to a picture relit under such patterns; standard error.
    """

    side: int
    predicted: float
    predicted_error: float


def random_signs(shape: tuple[int, ...], side: int, count: int, seed: int) -> Double:
    """Return patterns of patches of random sign, (count, *shape), values -1 and 1."""
    views, height, width = RayDomain(shape).stack_shape
    patches = (count, views, -(-height // side), -(-width // side))
    coarse = generator(seed, side).integers(0, 2, patches) * 2.0 - 1
    fine = coarse.repeat(side, axis=-2).repeat(side, axis=-1)
    return np.asarray(fine[..., :height, :width]).reshape(count, *shape)


def worst_of(scales: Iterable[Scale]) -> Scale:
    """Return the scale of the largest predicted error."""
    return max(scales, key=lambda scale: scale.predicted)


def measure_symmetry(floodlit: Double, variance: Double, pictures: list[Pictures]) -> list[Scale]:
    """Measure asymmetry from pictures under random patterns, from single rays on.

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
    if min(len(one.signs) for one in pictures) < 3:
        raise CaptureError(
            "fewer than three patterns of patches of a size make no two pairs; expected 3 or more"
        )
    signed = [(one, 2 * one.radiance - floodlit, 4 * one.variance + variance) for one in pictures]
    fine, images, noise = signed[0]
    ahead = np.einsum("in,nc->ic", fine.signs, floodlit) - images.sum(axis=1)
    of_ones = _mean_square(ahead, noise.sum(axis=1) + variance.sum(axis=0), len(fine.signs))
    scales = []
    for coarse, coarse_images, coarse_noise in signed:
        forward = np.einsum("jn,inc->ijc", fine.signs, coarse_images)
        backward = np.einsum("in,jnc->ijc", coarse.signs, images)
        spread = coarse_noise.sum(axis=1)[:, None] + noise.sum(axis=1)[None]
        once = np.ones(forward.shape[:2], bool)
        if coarse is fine:
            once = np.triu(once, 1)
        forward, backward, spread = forward[once], backward[once], spread[once]
        of_signs = _mean_square(forward - backward, spread, len(coarse.signs))
        light = np.square(coarse.radiance).sum(axis=1) - coarse.variance.sum(axis=1)
        unit = max(16 * float(light.sum(axis=1).mean()), _LEAST)
        square = (of_ones[0] + of_signs[0]) / unit
        error = float(np.hypot(of_ones[1], of_signs[1])) / unit
        # a square below zero is noise; far from zero half the relative error of the square, near
        # it what the error alone would be the square of
        predicted = float(np.sqrt(max(square, 0.0)))
        predicted_error = min(np.sqrt(error), error / max(2 * predicted, _LEAST))
        scales.append(Scale(coarse.side, predicted, predicted_error))
    return scales


def _mean_square(difference: Double, noise: Double, count: int) -> tuple[float, float]:
    """Return the mean square of pairs (n, C) without the noise's share, and its standard error.

    `count` independent patterns made the pairs.
    """
    squares = (difference**2 - noise).sum(axis=1)
    # where nothing but noise is left, its squares spread by twice their variance
    least = np.sqrt(2 * np.square(noise).sum(axis=1).mean())
    spread = max(float(squares.std(ddof=1)), float(least))
    return float(squares.mean()), spread / float(np.sqrt(min(len(squares), count)))


def symmetry_patterns(
    shape: tuple[int, ...], count: int, references: int, seed: int = 0
) -> Iterator[tuple[int, Double]]:
    """Yield the side and the signs (n, *shape) of patterns: all off, all on, and random ones.

    The sides of the former two are 0. Of random patterns, patches of 4 and 16 rays a side follow
    single rays where two fit.
    """
    ones = np.ones((references, *shape))
    yield from ((0, -ones), (0, ones))
    for side in (1, 4, 16):
        if side == 1 or side * 2 <= max(RayDomain(shape).image_shape):
            yield side, random_signs(shape, side, count, seed)


def merged_pictures(
    brackets: Iterable[NDArray[Any]], sensor: Sensor, patterns: Iterable[tuple[int, Double]]
) -> Taken:
    """Merge brackets (E, ...) under the patterns of `symmetry_patterns`, for `measure_symmetry`."""
    remaining = iter(brackets)
    (_, off), (_, on), *random = patterns
    black = np.mean([next(remaining) for _ in off], axis=0).astype(np.float32)
    merge = sensor.merging(black, MergeOptions(len(off)))

    def merged(count: int) -> tuple[Double, Double]:
        found = [merge(next(remaining)[None]) for _ in range(count)]
        images = ([one.radiance[0] for one in found], [one.variance[0] for one in found])
        channels = found[0].radiance.shape[-1]
        radiance, variance = (np.stack(part).astype(np.float64) for part in images)
        return radiance.reshape(count, -1, channels), variance.reshape(count, -1, channels)

    lit, noise = merged(len(on))
    pictures = [
        Pictures(side, signs.reshape(len(signs), -1), *merged(len(signs))) for side, signs in random
    ]
    return lit.mean(axis=0), noise.mean(axis=0) / len(on), pictures


def measure_rig(bench: Bench) -> Findings:
    """Show random patterns on the rays; judge their pictures."""
    arrays, settings = bench.found["rays"].arrays, bench.settings
    layout, resampling = ProjectorLayout.from_arrays(arrays), Resampling.from_arrays(arrays)
    counts = settings.symmetry_patterns, settings.dark_frames
    patterns = list(symmetry_patterns(layout.shape, *counts))
    lit = [signs > 0 for _, group in patterns for signs in group]
    brackets = bench.take(lit, linear=True, drawn=layout.picture)
    taken = merged_pictures(brackets, ResampledSensor(bench.model, resampling), patterns)
    return symmetry_findings(taken, settings.tolerance)


def symmetry_findings(taken: Taken, tolerance: float) -> Findings:
    """Predict the error that asymmetry makes in relit pictures, which `tolerance` is for."""
    scales = measure_symmetry(*taken)
    worst = worst_of(scales)
    error, margin = worst.predicted, CONFIDENCE * worst.predicted_error
    facts = {
        "tolerance": tolerance,
        "error": error,
        "standard_error": worst.predicted_error,
        "side_rays": worst.side,
        "least_error": error - margin,
        "most_error": error + margin,
    }
    arrays = {
        "sides": np.array([scale.side for scale in scales]),
        "predicted": np.array([scale.predicted for scale in scales]),
        "predicted_error": np.array([scale.predicted_error for scale in scales]),
    }
    return Findings.of("symmetry", facts, arrays)


@dataclass(frozen=True)
class Residual:
    """How one picture agrees with the previous ones.

    Attributes
    ----------
    deviations : float
        RMS of ``p' c_q - q' c_p`` over its standard deviation by the noise; 0 without any.
    error : float
        Least error of this picture, relative to its norm, if T is taken for symmetric.
    """

    deviations: float
    error: float

    def is_wrong(self, worth_a_word: float, significance: float = 6.0) -> bool:
        """Whether it is more than noise, and more than is worth a word."""
        return self.deviations > significance and self.error > worth_a_word


class Reciprocity:
    """Holds each picture of a coaxial rig against previous ones of the acquisition.

    Parameters
    ----------
    floodlit, variance : ndarray of float32, shape (*camera_shape, C)
        The floodlit image and its variance: the first witness. Infinite variance: not known.

    Notes
    -----
    With ``T = T'``, light from where pattern q is lit to where p is lit is what goes from p to q:
    ``p' c_q = q' c_p``. Of picture q and the witnesses p the residual is ``r_p = p' c_q g - q'
    c_p``, with one gain g for each channel, found by least squares, so that a lamp that drifts is
    no asymmetry. ``r = W K q`` of ``K = T - T'`` is the projection of ``K q`` on the witnesses, the
    rows of W: ``r' (W W')^+ r <= |K q|^2``, and a picture under q is wrong by ``K q / 2``. The
    noise's share of both is known and is taken off.
    """

    def __init__(self, floodlit: Float, variance: Float) -> None:
        known = np.isfinite(variance)
        rays, channels = known[..., 0].size, floodlit.shape[-1]
        self._unseen = _UNKNOWN * (1 - float(known.mean()))
        self._patterns = np.empty((_WITNESSES, rays), np.float32)
        self._images, self._noise = np.empty((2, _WITNESSES, rays, channels), np.float32)
        self._count = 0
        self._keep(np.ones(rays, np.float32), *_flat(floodlit, variance))

    def judge(self, pattern: Float, radiance: Float, variance: Float) -> Residual:
        """Hold a picture (*camera_shape, C) against the previous ones, and keep it as a witness."""
        q = np.asarray(pattern, np.float32).reshape(-1)
        image, noise = _flat(radiance, variance)
        held = min(self._count, _WITNESSES)
        patterns, images = self._patterns[:held], self._images[:held]
        back = np.tensordot(q, images, (0, 1)).astype(np.float64)  # q' c_p, (P, C)
        ahead = (patterns @ image).astype(np.float64)  # p' c_q
        spread = np.tensordot(q * q, self._noise[:held], (0, 1)).astype(np.float64)
        spread += (patterns * patterns) @ noise
        spread = np.maximum(spread, np.finfo(np.float32).eps ** 2 * np.maximum(ahead, back) ** 2)
        sure = np.divide(1, spread, out=np.zeros_like(spread), where=spread > 0)
        over, above = (sure * ahead * ahead).sum(axis=0), (sure * ahead * back).sum(axis=0)
        gain = np.divide(above, over, out=np.ones_like(over), where=over > 0)
        image, noise = (part.astype(np.float32) for part in (image * gain, noise * gain**2))
        found = self._residual(ahead * gain - back, spread, image, noise)
        self._keep(q, image, noise)
        return found

    def _residual(self, residual: Double, spread: Double, image: Float, noise: Float) -> Residual:
        held, channels = residual.shape
        light = float((np.square(image) - noise).sum(dtype=np.float64))
        if held < 2 or light <= 0:
            return Residual(0.0, 0.0)
        squares = np.divide(residual**2, spread, out=np.zeros_like(spread), where=spread > 0)
        deviations = float(np.sqrt(squares.sum() / ((held - 1) * channels)))
        gram = (self._patterns[:held] @ self._patterns[:held].T).astype(np.float64)
        values, vectors = np.linalg.eigh(gram)
        # directions of pattern space that the witnesses hardly span are all noise
        chosen = values > 0.05 * np.diag(gram).min()
        ways = vectors[:, chosen]
        along = (ways.T @ residual) ** 2 - (ways**2).T @ spread
        error = float((along.sum(axis=1) / values[chosen]).sum()) / (4 * light) - self._unseen
        return Residual(deviations, float(np.sqrt(max(error, 0.0))))

    def _keep(self, pattern: Float, image: Float, noise: Float) -> None:
        """Keep a witness; the floodlit image stays, the others make way in turn."""
        if not pattern.any():
            return
        at = self._count
        if at >= _WITNESSES:
            at = 1 + (at - _WITNESSES) % (_WITNESSES - 1)
        self._count += 1
        self._patterns[at], self._images[at], self._noise[at] = pattern, image, noise


def _flat(radiance: Float, variance: Float) -> tuple[Float, Float]:
    """Return an image and its variance as (N, C); pixels that aren't known are 0 in both."""
    known = np.isfinite(variance)
    flat = (np.where(known, image, 0) for image in (radiance, variance))
    image, noise = (each.reshape(-1, radiance.shape[-1]).astype(np.float32) for each in flat)
    return image, noise
