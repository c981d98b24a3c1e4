"""Colour normalization: a level's images made to add up to the floodlit image [B.2]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Mode = Literal["none", "per_channel", "total_energy"]

MAXIMUM_GAIN = 10.0
"""A level whose images hold less than the inverse of this of the floodlit image's energy at a
pixel didn't light it: nothing there to scale."""


@dataclass(frozen=True, eq=False)
class Normalization:
    """What `apply` does to the images of one level.

    Parameters
    ----------
    gain : ndarray of float32, shape (*camera_shape, C)
        Factor of each sample, 1 where nothing is done; in [0, MAXIMUM_GAIN] for "per_channel".
        For "total_energy" it multiplies an image's value summed over channels.
    covered : ndarray of bool, shape (*camera_shape, C)
        Samples that are scaled; the corrected images add up to the floodlit image there.
    """

    gain: NDArray[np.float32]
    covered: NDArray[np.bool_]
    mode: Mode


def level_gain(
    floodlit: NDArray[Any],
    total: NDArray[Any],
    total_variance: NDArray[Any],
    mode: Mode,
    complete: bool,
    significance: float,
    floodlit_variance: NDArray[Any],
) -> Normalization:
    """Return the factors that make a level's images add up to the floodlit image.

    Parameters
    ----------
    floodlit : ndarray of float, shape (*camera_shape, C)
        Radiance under the all-on pattern.
    total, total_variance : ndarray of float, same shape
        Sum of the level's images, and its variance (the sum of theirs).
    mode : {"none", "per_channel", "total_energy"}
        Nothing; each channel for itself; or, as in the thesis, the floodlit image's channels
        distributed to the images in proportion to their energy, summed over channels.
    complete : bool
        Whether the level lights every ray that can send light. If not, its images needn't add
        up to the floodlit image, and nothing is done anywhere.
    significance : float
        Standard deviations by which a total must exceed its noise to be scaled, at least 0.
    floodlit_variance : ndarray of float, same shape
        Variance of `floodlit`; huge where it is saturated, infinite where it is unknown.

    Returns
    -------
    Normalization
        Finite and bounded. Not covered: pixels where the total or the floodlit image is unknown,
        within noise or not positive, or where the total holds less than ``1 / MAXIMUM_GAIN`` of the
        floodlit image.
    """
    floodlit, floodlit_variance, total, total_variance = (
        np.asarray(array, np.float64)
        for array in (floodlit, floodlit_variance, total, total_variance)
    )
    if mode == "none" or not complete:
        nowhere = np.zeros(floodlit.shape, bool)
        return Normalization(np.ones(floodlit.shape, np.float32), nowhere, mode)
    target = floodlit
    if mode == "total_energy":
        # channels without light are noise about zero; light is not negative
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
    return Normalization(
        gain.astype(np.float32), np.array(np.broadcast_to(covered, gain.shape)), mode
    )


def apply(
    images: NDArray[np.float32], variance: NDArray[np.float32], normalization: Normalization
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Scale images of a level and their variance, float32 (P, *camera_shape, C).

    Returns the inputs themselves where nothing is covered. The noise of the gain is not part of the
    variance: it is common to all images of the level and below theirs. A channel whose light was
    taken away (gain 0) keeps its variance.
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
