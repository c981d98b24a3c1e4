"""Patterns that no method shows: what a transport is verified with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator

__all__ = ["NAMES", "unseen_patterns"]

Float = NDArray[np.float32]
Double = NDArray[np.float64]

_SEED = 15
_LEAVES = 400  # discs that fall one upon the other
_STEEP = 0.04  # share of the rays that the steep places have
_SMOOTHED = 1 / 32  # of the shorter side: what is steep is looked for above this scale

_Maker = Callable[[int, int, "Double | None"], NDArray[np.generic]]


def unseen_patterns(
    shape: tuple[int, ...], count: int, seen_from_projector: Float | None = None
) -> dict[str, Float]:
    """Make patterns to verify a transport with.

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain; each of several views gets the same picture.
    count : int
        How many, 1 to 10, in the order of `NAMES`.
    seen_from_projector : ndarray of float32, shape (*shape, C), optional
        The scene as the projector sees it (the dual picture of white light), in which
        ``steep`` finds where brightness changes most. None: across the middle.

    Returns
    -------
    dict of float32 arrays of `shape`, weights in [0, 1]
        ``natural``: discs of all sizes that cover each other, in shades of grey. ``stripes``:
        slanted, five rays a period. ``steep``: the twenty-fifth of the rays where the scene is
        steepest, such as a crease. ``spots``: scattered, three rays wide. ``bands``: broad level
        ones. ``rings``; ``grain``: a fifth of all rays, at random. ``checks``: squares of seven
        rays. ``slope``: a ramp from dark to light. ``gaps``: all but scattered spots. On tiny
        domains each keeps at least a ray.

    Notes
    -----
    The natural picture is made by the dead-leaves model, which has the statistics of photographs:
    edges at all scales, a spectrum of 1 / f^2 [A. B. Lee, D. Mumford and J. Huang, Occlusion models
    for natural images, International Journal of Computer Vision 41, 2001]. It and ``slope`` alone
    hold shades of grey, which need a projector whose response is known.
    """
    domain = RayDomain(tuple(shape))
    height, width = domain.image_shape
    steepness = None
    if seen_from_projector is not None:
        stack = seen_from_projector.reshape(*domain.stack_shape, -1)
        steepness = _steepness(stack[len(stack) // 2].mean(axis=-1, dtype=np.float64))
    made = {}
    for name in NAMES[:count]:
        picture = np.asarray(_MAKERS[name](height, width, steepness), np.float32)
        if not picture.any():
            picture[height // 2, width // 2] = 1
        made[name] = np.ascontiguousarray(np.broadcast_to(picture, shape))
    return made


def _natural(height: int, width: int, _: Double | None) -> Double:
    """Discs whose radii follow r^-3, between a ray and the longer side, the last ones on top."""
    random = generator(_SEED, 0)
    y, x = np.mgrid[:height, :width] + 0.5
    picture = np.full((height, width), 0.5)
    least, most = 1.0, float(max(height, width))
    for _leaf in range(_LEAVES):
        share = random.random()
        radius = 1 / np.sqrt(1 / least**2 - share * (1 / least**2 - 1 / most**2))
        at_y, at_x = random.random(2) * (height + radius, width + radius) - radius / 2
        picture[(y - at_y) ** 2 + (x - at_x) ** 2 < radius**2] = random.random()
    return picture


def _stripes(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    y, x = np.mgrid[:height, :width]
    return np.asarray((x + y // 3) % 5 < 2)


def _steep(height: int, width: int, steepness: Double | None) -> NDArray[np.bool_]:
    if steepness is None:
        across = np.zeros((height, width), np.bool_)
        across[:, width // 2] = True
        return across
    return np.asarray(steepness >= np.quantile(steepness, 1 - _STEEP))


def _spots(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    lit = np.zeros((height, width), np.bool_)
    random = generator(_SEED, 1)
    for _spot in range(max(1, height * width // 128)):
        top, left = random.integers(0, height), random.integers(0, width)
        lit[max(0, top - 1) : top + 2, max(0, left - 1) : left + 2] = True
    return lit


def _bands(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    rows = (np.arange(height) + max(1, height // 11)) % max(2, height // 3) < max(1, height // 7)
    return np.broadcast_to(rows[:, None], (height, width))


def _rings(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    y, x = np.mgrid[:height, :width]
    distance = np.hypot(y - 0.4 * height, x - 0.6 * width)
    return np.asarray(distance % max(3.0, min(height, width) / 4) < min(height, width) / 10)


def _grain(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    return np.asarray(generator(_SEED, 2).random((height, width)) < 0.2)


def _checks(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    y, x = np.mgrid[:height, :width]
    return np.asarray((y // 7 + x // 7) % 2 == 1)


def _slope(height: int, width: int, _: Double | None) -> Double:
    y, x = np.mgrid[:height, :width] + 0.5
    return np.asarray((y / height + x / width) / 2)


def _gaps(height: int, width: int, _: Double | None) -> NDArray[np.bool_]:
    return ~_spots(height, width, None)[::-1, ::-1]


_MAKERS: dict[str, _Maker] = {
    "natural": _natural,
    "stripes": _stripes,
    "steep": _steep,
    "spots": _spots,
    "bands": _bands,
    "rings": _rings,
    "grain": _grain,
    "checks": _checks,
    "slope": _slope,
    "gaps": _gaps,
}

NAMES = tuple(_MAKERS)
"""Names of all patterns, the most telling first."""


def _steepness(image: Double) -> Double:
    """Return how much the brightness changes from ray to ray, (H, W), beside the brightness."""
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(image, _SMOOTHED * min(image.shape))
    least = 1e-3 * float(smooth.max(initial=0.0)) or 1.0
    steps = [
        np.gradient(smooth, axis=axis) if length > 1 else np.zeros_like(smooth)
        for axis, length in enumerate(image.shape)
    ]
    return np.asarray(np.hypot(*steps) / np.maximum(smooth, least))
