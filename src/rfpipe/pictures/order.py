"""Whether pictures of a coaxial rig show their patterns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]

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
"""What turns a picture (H, W) or (H, W, C), by its name."""

# Correlation of pictures with their patterns from which on a rig behaves as a coaxial one, and by
# how much another pattern's or turn's is higher: see benchmarks/offline_faults.py.
_COAXIAL, _ABOVE = 0.75, 0.25
# Standard deviation that a picture of even light may have, as a share of white light, and share
# of the light from which on a pattern is looked for: one of fewer pixels may light a mirror alone.
_UNEVEN, _LEAST_LIT = 0.1, 0.1


# Pictures of the pattern before, at least, and their share of those that differ from their own.
_LATE, _LATE_SHARE = 3, 0.8
# Correlation of brightness with that of the patterns before, where shapes can't be compared.
_LATE_BRIGHTNESS = 0.9


def are_late(patterns: Float, light: Float, *, coaxial: bool) -> bool:
    """Test whether pictures, from some picture on, show the pattern before their own.

    Parameters
    ----------
    patterns, light : ndarray of float32, shape (K, H, W)
        Weights of the patterns, and light of the pictures.
    coaxial : bool
        Whether both share their rays, so that shapes can be compared; else brightness alone.
    """
    if not coaxial:
        shown, seen = patterns.mean(axis=(1, 2)), light.mean(axis=(1, 2))
        fit_before = correlation(shown[:-1], seen[1:])
        return fit_before > max(_LATE_BRIGHTNESS, correlation(shown[1:], seen[1:]) + _ABOVE)
    mean = light.mean(axis=0)
    lit = mean > mean.mean() / 4
    shown, seen = patterns[:, lit], light[:, lit] / mean[lit]
    own = np.array([correlation(one, two) for one, two in zip(shown, seen, strict=True)])[1:]
    before = np.array(
        [correlation(one, two) for one, two in zip(shown[:-1], seen[1:], strict=True)]
    )
    # a scene full of indirect light resembles other patterns by chance
    is_late = before > np.maximum(np.maximum(own, 0) + _ABOVE, _COAXIAL)
    is_own = own > np.maximum(before, 0) + _ABOVE
    first = int(is_late.argmax())
    count = int(is_late.sum())
    return count >= _LATE and count > _LATE_SHARE * (count + int(is_own[first:].sum()))


def correlation(one: Float, other: Float) -> float:
    """Return the correlation of two arrays of one shape, 0 where one is constant."""
    one, other = one - one.mean(), other - other.mean()
    norm = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float((one * other).sum()) / norm if norm > 0 else 0.0


def misplaced(patterns: Float, names: Sequence[str], light: Float) -> list[str]:
    """Say which pictures show something else than their patterns, and what.

    Nothing is said of pictures that noise hides, nor where the rig isn't coaxial after all.

    Parameters
    ----------
    patterns : ndarray of float32, shape (K, H, W)
        Weights from 0 to 1: a marker and its opposite, others, the opposite again.
    names : sequence of K str
        Of the pictures.
    light : ndarray of float32, shape (K, H, W)
        Of the pictures.
    """
    light = light - light.min(axis=0)
    white = light[0] + light[1]
    bright = white > white.mean() / 4  # dark pixels tell little

    def shapes(images: Float) -> tuple[Float, Float]:
        """Return images less their means, (K, pixels) of norm 1; and the variances of pixels."""
        flat = images[:, bright]
        flat = flat - flat.mean(axis=1, keepdims=True)
        power = np.maximum(np.square(flat).mean(axis=1), np.finfo(np.float32).eps)
        return flat / np.sqrt(power[:, None] * flat.shape[1]), power

    ratio = np.asarray(light / np.where(bright, white, np.inf), np.float32)
    (known, spread), (seen, power) = shapes(patterns), shapes(ratio)
    noise = shapes(ratio[1:2] - ratio[-1:])[1] / 2
    level, lit = (each[:, bright].mean(axis=1) for each in (ratio, patterns))
    edge = np.minimum(lit, 1 - lit)
    is_other = (power > np.maximum(_UNEVEN**2, 5 * noise)) | (np.abs(level - lit) > 0.5)
    other = np.flatnonzero(is_other & (edge < _UNEVEN**2 / 4))
    found = dict.fromkeys(other, "isn't evenly lit, or dark")
    shaped = edge > _LEAST_LIT
    told = np.flatnonzero(shaped & (noise < np.median((power / spread)[shaped]) * spread / 2))
    own = {
        turn: np.median(np.einsum("kp,kp->k", shapes(np.stack([*map(how, ratio)]))[0], known)[told])
        for turn, how in TURNS.items()
        if how(white).shape == white.shape
    }
    best = max(own, key=lambda turn: own[turn])
    if best and own[best] >= _COAXIAL and own[""] < _ABOVE:
        return [f"all pictures fit when they are {best}: turn them"]
    told = told if own[""] >= _COAXIAL else told[:0]
    for index, fit in zip(told, seen[told] @ known.T, strict=True):
        if fit.max() > fit[index] + _ABOVE:
            found[index] = f"shows the pattern of {names[int(fit.argmax())]}"
        elif fit[index] < _ABOVE:
            found[index] = "shows none of these patterns"
    said = [f"{names[int(index)]} {found[index]}" for index in sorted(found)]
    return said if len(said) <= 4 else [*said[:4], f"and {len(said) - 4} more"]
