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
_NAMED = 4  # pictures that a message names
_TINY = float(np.finfo(np.float32).eps)


def misplaced(patterns: Float, names: Sequence[str], light: Float, variance: Float) -> list[str]:
    """Say which pictures show something else than their patterns, and what.

    Nothing is said of pictures that noise hides, nor where the rig isn't coaxial after all.

    Parameters
    ----------
    patterns : ndarray of float32, shape (K, H, W)
        Weights from 0 to 1; the first two are a marker and its opposite.
    names : sequence of K str
        Of the pictures.
    light, variance : ndarray of float32, shape (K, H, W)
        Of the pictures.
    """
    light = light - light.min(axis=0)
    white = light[0] + light[1]
    over = np.where(white > 0, white, np.inf)
    share = np.maximum(white, 0) / (over + white.mean())  # dark pixels tell little
    share /= max(share.sum(), _TINY)
    ratio = np.asarray(np.clip(light / over, -1, 2), np.float32)

    def mean(images: Float) -> Float:
        return np.asarray(np.einsum("hw,khw->k", share, images))

    def shapes(images: Float) -> tuple[Float, Float]:
        """Return images without their means, weighted, (K, H W) of norm 1; and squared norms."""
        flat = ((images - mean(images)[:, None, None]) * np.sqrt(share)).reshape(len(images), -1)
        power = np.maximum(np.square(flat).sum(axis=1), _TINY)
        return flat / np.sqrt(power)[:, None], power

    (known, spread), (seen, power), lit = shapes(patterns), shapes(ratio), mean(patterns)
    noise, edge = mean(np.minimum(variance / over**2, 1)), np.minimum(lit, 1 - lit)
    uneven = (power > np.maximum(_UNEVEN**2, 5 * noise)) & (edge < _UNEVEN**2 / 4)
    found = dict.fromkeys(np.flatnonzero(uneven), "isn't evenly lit")
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
    return said if len(said) <= _NAMED else [*said[:_NAMED], f"and {len(said) - _NAMED} more"]
