"""The error of a relit picture, from pictures that no fit sees.

They are drawn from those that people relight (`rfpipe.relighting`): shapes, bars and spots.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.methods.images import Pictures
from rfpipe.provenance import generator
from rfpipe.relighting import KINDS, across, reference_light, shapes, spot, typical_indirect
from rfpipe.transport.base import Transport

HELD_OUT = ("shapes", "shapes", "bars", "spots", "bars", "spots")
"""Kinds of the held-out pictures. The first two are of one pattern: they tell the noise."""

_BARS = 5
_SPOTS = 20  # of one picture, far apart, each judged in its own part of the image
_TRIED = 20  # places of a spot, of which that is taken that is farthest from all others
_SEED = 2010

Bools = NDArray[np.bool_]
Double = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """Errors of relit pictures, see `rfpipe.relighting.relative_errors`.

    Attributes
    ----------
    shapes, bars, spots : float
        Mean errors of the kinds of pictures.
    indirect : float
        Mean error on pixels without direct light, of the indirect light there; NaN where these
        aren't known.
    """

    shapes: float
    bars: float
    spots: float
    indirect: float = np.nan

    @property
    def error(self) -> float:
        """Expected of a picture: a third of what people relight is of each kind."""
        return (self.shapes + self.bars + self.spots) / 3


@lru_cache(maxsize=8)
def held_out_parts(shape: tuple[int, ...]) -> tuple[Bools, ...]:
    """Return the patterns of the held-out pictures, each as parts, bool (parts, N).

    Parallel bars, and spots, are parts of one pattern; shapes are one part. Of a stack, the last
    bars light one view alone, and each of the last spots one.
    """
    domain, drawn = RayDomain(shape), []
    image = domain.image_shape
    for index, kind in enumerate(HELD_OUT):
        random = generator(_SEED, max(index, 1))
        if kind == "shapes":
            parts = shapes(image, random, 0.3)[None]
        elif kind == "bars":
            # the second ones stand across the first
            parts = _bars(image, random, (0.15 + index / 4) * np.pi)
        else:
            parts = _spots(image, random)
        views = np.ones((len(parts), domain.views, 1, 1), np.bool_)
        if index >= len(HELD_OUT) - 2:
            lit = random.integers(domain.views, size=len(parts) if kind == "spots" else 1)
            views = (np.arange(domain.views) == lit[:, None])[..., None, None]
        drawn.append((parts[:, None] & views).reshape(len(parts), -1))
    return tuple(drawn)


def _bars(shape: tuple[int, int], random: np.random.Generator, angle: float) -> Bools:
    """Draw parallel bars, the first two pixels wide, the last a fifth of the image, (bars, H, W).

    Of the error of one half plane half is by chance; bars together are about as wrong.
    """
    place = across(shape, angle)
    widths = np.geomspace(2, max(2.0, min(shape) / 5), _BARS)
    gap = max(np.ptp(place) - widths.sum(), 0) / _BARS
    starts = place.min() + gap * random.uniform(0.1, 0.9) + np.cumsum(widths + gap) - widths - gap
    ends = starts + widths
    bars = [(place >= start) & (place < end) for start, end in zip(starts, ends, strict=True)]
    # the corner of an image may have no pixel of a bar
    return np.stack([each for each in bars if each.any()] or [place == place.min()])


def _spots(shape: tuple[int, int], random: np.random.Generator) -> Bools:
    """Draw spots of all sizes, each far from those before it, (spots, H, W)."""
    drawn: list[Bools] = []
    centres = np.empty((0, 2))
    for size in (random.permutation(_SPOTS) + random.random(_SPOTS)) / _SPOTS:
        places = [spot(shape, random, size) for _ in range(_TRIED)]
        middles = np.array([np.argwhere(place).mean(axis=0) for place in places])
        apart = np.linalg.norm(middles[:, None] - centres, axis=-1).min(axis=1, initial=np.inf)
        best = int(np.argmax(apart))
        # on tiny images, spots would lie over one another
        own = places[best] & ~np.any(drawn, axis=0)
        if own.any():
            drawn.append(own)
        centres = np.concatenate([centres, middles[best : best + 1]])
    return np.stack(drawn)


def held_out_patterns(shape: tuple[int, ...]) -> Bools:
    """Return the patterns of the held-out pictures, bool (pictures, *shape)."""
    whole = [parts.any(axis=0) for parts in held_out_parts(tuple(shape))]
    return np.stack(whole).reshape(-1, *shape)


def relit(transport: Transport, patterns: NDArray[Any]) -> Float:
    """Return a transport's pictures (P, C, M) of patterns (P, N) of white light."""
    shape = (len(patterns), transport.channels, patterns.shape[1])
    light = np.broadcast_to(patterns[:, None].astype(np.float32), shape)
    return transport.forward(light, range(transport.channels))


def error_of(transport: Transport, held: Pictures, floodlit: Float, dark: Bools) -> Estimate:
    """Compare a transport's pictures with the held-out ones, each part where it is brightest.

    What noise adds is taken off: that of the pictures' variances, times the scale that the two
    pictures of the first pattern tell. Pixels that aren't known, or saturated, don't count.

    Parameters
    ----------
    transport : Transport
    held : Pictures
        Of `held_out_patterns`, in their order.
    floodlit : ndarray of float32, shape (C, M)
    dark : ndarray of bool, shape (pictures, M)
        The pixels that get no direct light.
    """
    parts = held_out_parts(transport.projector_shape)
    predicted = [relit(transport, each) for each in parts]
    known = held.measured
    taken, variance = (
        each[..., known].astype(np.float64) for each in (held.radiance, held.variance)
    )
    spread = float(variance[:2].sum())
    scale = float(np.square(taken[0] - taken[1]).sum()) / spread if spread > 0 else 0.0
    noise = (scale * variance).sum(axis=1)
    whole_pictures = np.stack([each.sum(axis=0)[:, known] for each in predicted])
    wrong = np.square(whole_pictures - taken).sum(axis=1) - noise
    light = np.square(taken).sum(axis=1) - noise
    full = float(np.square(floodlit[:, known], dtype=np.float64).sum())
    errors: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for index, (kind, pattern) in enumerate(zip(HELD_OUT, parts, strict=True)):
        brightest = predicted[index].sum(axis=1)[:, known].argmax(axis=0)
        judged = (brightest[:, None] == np.arange(len(pattern))).astype(np.float64)
        whole = reference_light(light[index] @ judged, full * pattern.mean(axis=1))
        chance = np.sqrt(2 * np.square(noise[index]) @ judged)
        errors[kind].append(_mean_error(wrong[index] @ judged, chance, whole))
    by_kind = {kind: float(np.mean(errors[kind])) for kind in KINDS}
    # of many parts together, errors add up as chance does, and light more than that: each is judged
    # by its share of the error, and by the light that it is predicted to send there alone
    count = np.array([len(pattern) for pattern in parts])
    of_dark = (wrong * dark[:, known]).sum(axis=1) / count
    by_chance = np.sqrt((2 * np.square(noise) * dark[:, known]).sum(axis=1)) / count
    alone = zip(predicted, dark & known, strict=True)
    indirect = np.array([np.square(each[..., unlit]).sum() for each, unlit in alone]) / count
    lit = held.lit.mean(axis=1) / count
    whole = reference_light(indirect, typical_indirect(indirect, lit))
    kinds = np.array(HELD_OUT)
    unlit = [
        _mean_error(*(each[kinds == kind] for each in (of_dark, by_chance, whole)))
        for kind in KINDS
    ]
    return Estimate(**by_kind, indirect=float(np.mean(unlit)))


def _mean_error(wrong: Double, chance: Double, whole: Double) -> float:
    """Return the mean error of parts from their squared errors, which noise may make negative.

    The mean of roots is too large where noise is, their root mean square where parts differ.
    """
    there = whole > 0
    squares, by_chance = wrong[there] / whole[there], chance[there] / whole[there]
    if not squares.size:
        return 0.0
    error = min(float(np.sqrt(squares.clip(0)).mean()), np.sqrt(max(float(squares.mean()), 0.0)))
    # what chance makes of a sum is the least error that can be told from none
    least = float(np.linalg.norm(by_chance)) / squares.size
    return max(float(error), float(np.sqrt(least)))
