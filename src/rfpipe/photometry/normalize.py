"""Colour normalization: scaling of a level's images to add up to the floodlit image [B.2]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.units import NormalizationMode

MAXIMUM_GAIN = 10.0
"""Largest factor of a sample. A pixel that would need a larger one was not lit by the level."""


@dataclass(frozen=True, eq=False)
class LevelGain:
    """Scaling of the images of one level.

    Parameters
    ----------
    gain : ndarray of float32, shape (*camera_shape, C)
        Factor of each sample, 1 where it isn't scaled; in [0, MAXIMUM_GAIN] for "per_channel". For
        "total_energy" it multiplies an image's sum over channels.
    covered : ndarray of bool, shape (*camera_shape, C)
        Samples that are scaled; the corrected images add up to the floodlit image there.
    """

    gain: NDArray[np.float32]
    covered: NDArray[np.bool_]
    mode: NormalizationMode


def level_gain(
    floodlit: NDArray[Any],
    total: NDArray[Any],
    total_variance: NDArray[Any],
    mode: NormalizationMode,
    complete: bool,
    significance: float,
    floodlit_variance: NDArray[Any],
) -> LevelGain:
    """Compute the factors with which a level's images add up to the floodlit image.

    Parameters
    ----------
    floodlit : ndarray of float, shape (*camera_shape, C)
        Radiance under the all-on pattern.
    total, total_variance : ndarray of float, same shape
        Sum of the level's images, and its variance (the sum of theirs).
    mode : {"none", "per_channel", "total_energy"}
        No scaling; scaling of each channel separately; or, as in the thesis, distribution of the
        floodlit image's channels to the images in proportion to their sum over channels.
    complete : bool
        Whether the level lights every ray that can send light. Otherwise its images don't add up to
        the floodlit image, and nothing is scaled.
    significance : float
        Standard deviations by which a total must exceed its noise to be scaled, at least 0.
    floodlit_variance : ndarray of float, same shape
        Variance of `floodlit`; huge where it is saturated, infinite where it is unknown.

    Returns
    -------
    LevelGain
        Finite and bounded. Pixels are not covered where the total or the floodlit image is unknown,
        within noise or not positive, or where the total is less than ``1 / MAXIMUM_GAIN`` of the
        floodlit image.
    """
    floodlit, floodlit_variance, total, total_variance = (
        np.asarray(array, np.float64)
        for array in (floodlit, floodlit_variance, total, total_variance)
    )
    if mode == "none" or not complete:
        nowhere = np.zeros(floodlit.shape, bool)
        return LevelGain(np.ones(floodlit.shape, np.float32), nowhere, mode)
    target = floodlit
    if mode == "total_energy":
        # channels without light have noise around zero, but light is not negative
        target = np.maximum(floodlit, 0)
        floodlit, floodlit_variance, total, total_variance = (
            array.sum(axis=-1, keepdims=True)
            for array in (target, floodlit_variance, total, total_variance)
        )
    known = np.isfinite(floodlit_variance) & np.isfinite(total_variance)
    floodlit_noise, total_noise = (
        np.sqrt(np.where(known, variance, 0)) for variance in (floodlit_variance, total_variance)
    )
    covered = (
        known
        & (total > significance * total_noise)
        & (floodlit > significance * floodlit_noise)
        & (total > floodlit / MAXIMUM_GAIN)
    )
    gain = np.divide(target, total, out=np.ones_like(target), where=covered)
    return LevelGain(gain.astype(np.float32), np.array(np.broadcast_to(covered, gain.shape)), mode)


def apply(
    images: NDArray[np.float32], variance: NDArray[np.float32], normalization: LevelGain
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Scale images of a level and their variance, float32 (P, *camera_shape, C).

    Returns the inputs if nothing is covered. The variance doesn't include the noise of the gain,
    which is common to all images of the level and smaller than theirs. A channel with a gain of 0
    keeps its variance.
    """
    if not normalization.covered.any():
        return images, variance
    gain, covered = normalization.gain, normalization.covered
    energy, spread = images, variance
    if normalization.mode == "total_energy":
        energy = images.sum(axis=-1, keepdims=True)
        spread = variance.sum(axis=-1, keepdims=True)
    scaled = np.where(covered, energy * gain, images)
    return scaled, np.where(covered & (gain > 0), spread * np.square(gain), variance)
