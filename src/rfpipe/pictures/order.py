"""Tests whether pictures show the patterns that they are assigned to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float

TURNS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "": lambda picture: picture,
    "turned by 180 degrees": lambda picture: picture[::-1, ::-1],
    "turned by 90 degrees clockwise": lambda picture: np.rot90(picture, -1),
    "turned by 90 degrees counterclockwise": np.rot90,
    "mirrored left to right": lambda picture: picture[:, ::-1],
    "mirrored top to bottom": lambda picture: picture[::-1],
    "mirrored along the diagonal": lambda picture: np.swapaxes(picture, 0, 1),
    "mirrored along the other diagonal": lambda picture: np.rot90(np.swapaxes(picture, 0, 1), 2),
}
"""Functions that turn or mirror a picture (H, W) or (H, W, C), by name."""

# Least correlation of pictures and patterns on a coaxial rig, and least advantage of another
# pattern or orientation: see benchmarks/offline_faults.py.
_COAXIAL, _ABOVE = 0.75, 0.25
# Largest standard deviation of a picture of even light, relative to white; and least share of lit
# pixels of a compared pattern, since a smaller pattern may light a mirror only.
_UNEVEN, _LEAST_LIT = 0.1, 0.1


# Least number of pictures of the previous pattern, and their least share of the distinct pictures.
_LATE, _LATE_SHARE = 3, 0.8
# Least correlation of brightness with the previous patterns, where shapes can't be compared.
_LATE_BRIGHTNESS = 0.9


def are_late(patterns: Float, light: Float, *, coaxial: bool) -> bool:
    """Test whether pictures, from some picture on, show the previous pattern.

    Parameters
    ----------
    patterns, light : ndarray of float32, shape (K, H, W)
        Weights of the patterns, and light of the pictures.
    coaxial : bool
        Whether patterns and pictures have common rays, so that their shapes can be compared;
        otherwise only their brightness is.
    """
    if not coaxial:
        weights, brightness = patterns.mean(axis=(1, 2)), light.mean(axis=(1, 2))
        late_correlation = correlation(weights[:-1], brightness[1:])
        fit = correlation(weights[1:], brightness[1:])
        return late_correlation > max(_LATE_BRIGHTNESS, fit + _ABOVE)
    mean = light.mean(axis=0)
    lit = mean > mean.mean() / 4
    shapes, images = patterns[:, lit], light[:, lit] / mean[lit]
    own_fit = np.array([correlation(*pair) for pair in zip(shapes[1:], images[1:], strict=True)])
    previous_fit = np.array(
        [correlation(*pair) for pair in zip(shapes[:-1], images[1:], strict=True)]
    )
    # in a scene full of indirect light, pictures resemble any pattern by chance
    is_late = previous_fit > np.maximum(np.maximum(own_fit, 0) + _ABOVE, _COAXIAL)
    is_right = own_fit > np.maximum(previous_fit, 0) + _ABOVE
    first = int(is_late.argmax())
    count = int(is_late.sum())
    return count >= _LATE and count > _LATE_SHARE * (count + int(is_right[first:].sum()))


def correlation(first: Float, second: Float) -> float:
    """Correlation of two arrays of one shape, 0 if one is constant."""
    first, second = first - first.mean(), second - second.mean()
    norm = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float((first * second).sum()) / norm if norm > 0 else 0.0


def misplaced(patterns: Float, names: Sequence[str], light: Float) -> list[str]:
    """Describe pictures of a coaxial rig that don't show their patterns.

    Pictures in which noise hides the pattern are not judged, and none are if the rig turns out not
    to be coaxial.

    Parameters
    ----------
    patterns : ndarray of float32, shape (K, H, W)
        Weights from 0 to 1: a marker and its complement, patterns, the complement.
    names : sequence of K str
        Names of the pictures.
    light : ndarray of float32, shape (K, H, W)
        Light of the pictures.
    """
    light = light - light.min(axis=0)
    white = light[0] + light[1]
    bright = white > white.mean() / 4  # excludes dark pixels

    def shapes(images: Float) -> tuple[Float, Float]:
        """Images minus their means, scaled to norm 1, (K, pixels); and variances, (K,)."""
        flat = images[:, bright]
        flat = flat - flat.mean(axis=1, keepdims=True)
        power = np.maximum(np.square(flat).mean(axis=1), np.finfo(np.float32).eps)
        return flat / np.sqrt(power[:, None] * flat.shape[1]), power

    ratio = np.asarray(light / np.where(bright, white, np.inf), np.float32)
    (pattern_shapes, spread), (picture_shapes, power) = shapes(patterns), shapes(ratio)
    noise = shapes(ratio[1:2] - ratio[-1:])[1] / 2
    level, lit = (images[:, bright].mean(axis=1) for images in (ratio, patterns))
    edge = np.minimum(lit, 1 - lit)  # small for all-on and all-off patterns
    is_wrong = (power > np.maximum(_UNEVEN**2, 5 * noise)) | (np.abs(level - lit) > 0.5)
    uneven = np.flatnonzero(is_wrong & (edge < _UNEVEN**2 / 4))
    faults = dict.fromkeys(uneven, "isn't evenly lit, or dark")
    shaped = edge > _LEAST_LIT
    judged = np.flatnonzero(shaped & (noise < np.median((power / spread)[shaped]) * spread / 2))
    fits = {
        turn: np.median(
            np.einsum("kp,kp->k", shapes(np.stack([*map(turned, ratio)]))[0], pattern_shapes)[
                judged
            ]
        )
        for turn, turned in TURNS.items()
        if turned(white).shape == white.shape
    }
    best = max(fits, key=lambda turn: fits[turn])
    if best and fits[best] >= _COAXIAL and fits[""] < _ABOVE:
        return [f"all pictures fit when they are {best}: turn them"]
    judged = judged if fits[""] >= _COAXIAL else judged[:0]
    for index, fit in zip(judged, picture_shapes[judged] @ pattern_shapes.T, strict=True):
        if fit.max() > fit[index] + _ABOVE:
            faults[index] = f"shows the pattern of {names[int(fit.argmax())]}"
        elif fit[index] < _ABOVE:
            faults[index] = "shows none of these patterns"
    lines = [f"{names[int(index)]} {faults[index]}" for index in sorted(faults)]
    return lines if len(lines) <= 4 else [*lines[:4], f"and {len(lines) - 4} more"]
