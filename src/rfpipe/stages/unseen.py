"""Patterns that no method shows: what a transport is verified with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator

Float = NDArray[np.float32]

NAMES = (
    "natural", "stripes", "steep", "spots", "bands", "rings", "grain", "checks", "slope", "gaps",
)  # fmt: skip
"""Names of all patterns, the most telling first."""

_SEED = 15  # of what is random in the patterns


def unseen_patterns(
    shape: tuple[int, ...], count: int, from_projector: Float | None = None
) -> dict[str, Float]:
    """Return the first `count` patterns, each an array of `shape` with weights in [0, 1].

    Parameters
    ----------
    shape : tuple of int
        The projector's ray domain; each of several views gets the same picture.
    count : int
        How many, 1 to 10, in the order of `NAMES`.
    from_projector : ndarray of float32, shape (*shape, C), optional
        The scene as the projector sees it (the dual picture of white light), in which
        ``steep`` finds where brightness changes most. None: across the middle.

    Returns
    -------
    dict of str to ndarray of float32
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
    shorter = min(height, width)
    y, x = np.mgrid[:height, :width]
    spots = _spots(height, width)
    pictures: dict[str, NDArray[np.generic]] = {
        "natural": _natural(height, width),
        "stripes": (x + y // 3) % 5 < 2,
        "steep": x == width // 2 if from_projector is None else _steep(domain, from_projector),
        "spots": spots,
        "bands": (y + max(1, height // 11)) % max(2, height // 3) < max(1, height // 7),
        "rings": np.hypot(y - 0.4 * height, x - 0.6 * width) % max(3.0, shorter / 4) < shorter / 10,
        "grain": generator(_SEED, 2).random((height, width)) < 0.2,
        "checks": (y // 7 + x // 7) % 2 == 1,
        "slope": ((y + 0.5) / height + (x + 0.5) / width) / 2,
        "gaps": ~spots[::-1, ::-1],
    }
    made = {}
    for name in NAMES[:count]:
        picture = np.asarray(pictures[name], np.float32)
        if not picture.any():
            picture[height // 2, width // 2] = 1
        made[name] = np.ascontiguousarray(np.broadcast_to(picture, shape))
    return made


def _natural(height: int, width: int) -> NDArray[np.float64]:
    """Draw 400 discs whose radii follow r^-3, between a ray and the longer side."""
    random = generator(_SEED, 0)
    y, x = np.mgrid[:height, :width] + 0.5
    picture = np.full((height, width), 0.5)
    longest = 1 / float(max(height, width)) ** 2
    for _ in range(400):
        radius = 1 / np.sqrt(1 - random.random() * (1 - longest))
        at_y, at_x = random.random(2) * (height + radius, width + radius) - radius / 2
        picture[(y - at_y) ** 2 + (x - at_x) ** 2 < radius**2] = random.random()
    return picture


def _spots(height: int, width: int) -> NDArray[np.bool_]:
    lit = np.zeros((height, width), np.bool_)
    random = generator(_SEED, 1)
    for _ in range(max(1, height * width // 128)):
        top, left = random.integers(0, height), random.integers(0, width)
        lit[max(0, top - 1) : top + 2, max(0, left - 1) : left + 2] = True
    return lit


def _steep(domain: RayDomain, from_projector: Float) -> NDArray[np.bool_]:
    """Find the rays of the middle view where relative brightness changes most from ray to ray."""
    from scipy.ndimage import gaussian_filter

    stack = from_projector.reshape(*domain.stack_shape, -1)
    image = stack[len(stack) // 2].mean(axis=-1, dtype=np.float64)
    smooth = gaussian_filter(image, min(image.shape) / 32)
    least = 1e-3 * float(smooth.max(initial=0.0)) or 1.0
    steps = [
        np.gradient(smooth, axis=axis) if length > 1 else np.zeros_like(smooth)
        for axis, length in enumerate(image.shape)
    ]
    steepness = np.hypot(*steps) / np.maximum(smooth, least)
    return np.asarray(steepness >= np.quantile(steepness, 0.96))
