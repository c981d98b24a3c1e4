"""Whether a coaxial rig's light transport is symmetric enough for symmetric photography."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.calibration.asymmetry import Causes
from rfpipe.calibration.base import Findings, Verdict
from rfpipe.keys import BLACK_LEVEL_KEY, FLOODLIT_KEY
from rfpipe.photometry import MergeOptions
from rfpipe.photometry.symmetry import CONFIDENCE, Pictures, Symmetry, random_signs
from rfpipe.rigs import Rig

__all__ = ["symmetry_findings", "symmetry_pictures", "take_symmetry"]

Double = NDArray[np.float64]

SCALES = (1, 4, 16)
"""Sides, in rays, of the patches that random patterns are made of."""


def take_symmetry(
    rig: Rig, count: int, black_count: int, seed: int = 0
) -> tuple[Double, Double, list[Pictures]]:
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
    for side in _sides(shape):
        signs = random_signs(shape, side, count, seed)
        taken = merged((signs > 0).astype(np.float32), side)
        pictures.append(Pictures.of(signs, taken, (floodlit, variance), side))
    return floodlit, variance, pictures


def symmetry_pictures(shape: tuple[int, ...], count: int, black_count: int) -> int:
    """Count the pictures that `take_symmetry` shows on a domain of rays."""
    return 2 * black_count + count * len(_sides(shape))


def _sides(shape: tuple[int, ...]) -> list[int]:
    """Return the sides of the patches of random patterns: two must fit."""
    return [side for side in SCALES if side == 1 or side * 2 <= max(RayDomain(shape).image_shape)]


def symmetry_findings(
    symmetry: Symmetry, tolerance: float, causes: Causes | None = None
) -> Findings:
    """Return the step's findings, with a verdict whether the predicted error is accepted.

    Parameters
    ----------
    symmetry : Symmetry
    tolerance : float
        Relative error of a relit picture that the rig is to stay below.
    causes : Causes, optional
        What makes the asymmetry.
    """
    worst = symmetry.worst
    low = worst.least
    high = worst.predicted + CONFIDENCE * worst.predicted_error
    rays = "single rays" if worst.side == 1 else f"patches of {worst.side} x {worst.side} rays"
    found = (
        f"asymmetry alone makes errors of {worst.predicted:.2%} +- {worst.predicted_error:.2%} in "
        f"pictures relit with {rays}, {tolerance:.1%} accepted"
    )
    why = "" if causes is None else _told(causes)
    if high <= tolerance:
        verdict = Verdict("good", f"Good enough for symmetric photography: {found}.{why}")
    elif low > tolerance:
        verdict = Verdict(
            "poor",
            f"Not good enough for symmetric photography: {found}."
            + (why or " Its cause isn't known. Largest at one ray: align the two devices' centres, "
               "or focus. At patches of many rays: flare, or unequal vignetting.")
            + " Dual photography doesn't need symmetry.",
        )  # fmt: skip
    else:
        verdict = Verdict(
            "unknown",
            f"The noise can't tell: {found}.{why} Use more patterns, or longer exposures.",
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
    if causes is not None:
        names = "flare", "flare_error", "vignetting", "vignetting_error"
        facts |= {name: getattr(causes, name) for name in names}
    arrays = {
        f"{name}_{scale.side}": getattr(scale, name)
        for scale in symmetry.scales
        for name in ("forward", "backward", "error")
    }
    return Findings(verdict, facts, arrays)


def _told(causes: Causes) -> str:
    """Say what makes the asymmetry, how large it is, the error that follows, and what to do."""
    text = ""
    if causes.has_flare:
        text += (
            f" Flare: the lens spreads {causes.flare:.1%} +- {causes.flare_error:.1%} of the light "
            f"over the picture, which makes an error of {causes.flare_makes:.1%}: clean and shade "
            "the lens, and cover what is bright beside the scene."
        )
    if causes.has_vignetting:
        text += (
            f" Vignetting: the camera loses {causes.vignetting:.0%} +- "
            f"{causes.vignetting_error:.0%} more light in its corners than the projector does, "
            f"which makes an error of {causes.vignetting_makes:.1%}: close the aperture, or take a "
            "longer lens."
        )
    if text:
        rest = causes.rest.worst
        them = "them" if causes.has_flare and causes.has_vignetting else "it"
        text += (
            f" Without {them} {rest.predicted:.1%} +- "
            f"{rest.predicted_error:.1%} would be left, of misalignment, blur or noise."
        )
    return text
