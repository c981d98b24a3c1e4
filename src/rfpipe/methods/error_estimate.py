"""Estimate of the mean error of relit pictures, from pictures that no fit uses.

The held-out pictures are of the kinds that people relight (`rfpipe.relighting`): shapes, bars and
spots. Bars and spots are parts of one pattern, to compare many of them for the cost of one picture;
the error of each part, relit alone, follows from the pattern's.

============  ================  ==============================================================
symbol        name              meaning
============  ================  ==============================================================
``e``         ``squares``       error of the pattern's relit picture; its squares, an image
``e_i``                         error of part i, relit alone; ``e = sum e_i``
``f``         ``of_floodlit``   error of the relit floodlit picture, an image
``s_i, s``    ``shares``        lit share of the rays, of a part and of the pattern
============  ================  ==============================================================

The floodlit picture is fitted, or known, and the errors of parts aren't independent: those of all
rays add up to f, nearly nought. For rays drawn at random, e is the sum of a sample from a finite
population [1]_: ``|e|^2`` is ``a s + b s^2``, with ``a + b = |f|^2``, and ``|e_i|^2`` is
``a s_i + b s_i^2``. Thus the ``|e_i|^2`` add up to ``|e|^2`` where errors are independent, and to
``sum s_i (1 - s_i) / (s (1 - s))`` times that where f is nought. On images of 16 x 18, bars and
spots light so large a share of the rays that this is 1.4 to 1.7.

Light, other than errors, isn't random: parts light one another's pixels, and ``|T p|^2`` exceeds
the sum of ``|T p_i|^2``, to which errors are relative. The measured light of a part's region is
therefore corrected by the predicted difference.

References
----------
.. [1] W. G. Cochran, *Sampling Techniques*, 3rd ed., Wiley 1977, ch. 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.methods.images import Pictures, relight_white
from rfpipe.provenance import generator
from rfpipe.relighting import KINDS, across, reference_light, shapes, spot, typical_indirect
from rfpipe.transport.base import Transport

HELD_OUT = ("shapes", "shapes", "bars", "spots", "bars", "spots")
"""Kinds of the held-out pictures. The first two are of one pattern: they tell the noise."""

_BARS = 5
_SPOTS = 20  # of one picture, far apart
_MOST_LIT = (
    0.5  # share of the rays that bars or spots light together; fewer of them on small images
)
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
    while len(widths) > 1 and widths.sum() > _MOST_LIT * (np.ptp(place) + 1):
        widths = np.geomspace(2, widths[-1], len(widths) - 1)
    gap = max(np.ptp(place) - widths.sum(), 0) / len(widths)
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
        added = places[best] & ~np.any(drawn, axis=0)
        if drawn and np.sum(drawn) + added.sum() > _MOST_LIT * added.size:
            break
        if added.any():
            drawn.append(added)
        centres = np.concatenate([centres, middles[best : best + 1]])
    return np.stack(drawn)


def held_out_patterns(shape: tuple[int, ...]) -> Bools:
    """Return the patterns of the held-out pictures, bool (pictures, *shape)."""
    whole = [parts.any(axis=0) for parts in held_out_parts(tuple(shape))]
    return np.stack(whole).reshape(-1, *shape)


@dataclass(frozen=True)
class _Comparison:
    """Squared errors of the parts of a held-out pattern, as if each was relit alone.

    Attributes
    ----------
    wrong, chance, light : ndarray of float64, shape (parts,)
        Squared error without the share of noise, the standard deviation that noise gives it, and
        squared light.
    dark_wrong, dark_chance, dark_light : float
        The same on pixels without direct light; means of the parts.
    """

    wrong: Double
    chance: Double
    light: Double
    dark_wrong: float
    dark_chance: float
    dark_light: float


def error_of(transport: Transport, held: Pictures, floodlit: Float, dark: Bools) -> Estimate:
    """Estimate a transport's mean error from the held-out pictures; see the module's equations.

    The share of noise is subtracted: the pictures' variances, times a scale by which the two
    pictures of the first pattern differ. Pixels that are unknown or saturated don't count.

    Parameters
    ----------
    transport : Transport
    held : Pictures
        Of `held_out_patterns`, in their order.
    floodlit : ndarray of float32, shape (C, M)
    dark : ndarray of bool, shape (pictures, M)
        Pixels without direct light.
    """
    patterns, known = held_out_parts(transport.projector_shape), held.measured
    every_ray = np.ones((1, patterns[0].shape[1]), np.bool_)
    of_floodlit, noise = relight_white(transport, every_ray)[0] - floodlit, _noise_of(held)
    full = float(np.square(floodlit[:, known], dtype=np.float64).sum())
    of_parts: dict[str, list[Double]] = {kind: [] for kind in KINDS}
    compared = []
    for index, (kind, parts) in enumerate(zip(HELD_OUT, patterns, strict=True)):
        taken, noisy, unlit = held.radiance[index], noise[index], dark[index]
        each = _compared(transport, parts, taken, of_floodlit, noisy, unlit, known)
        reference = reference_light(each.light, full * parts.mean(axis=1))
        of_parts[kind].append(np.stack([each.wrong, each.chance, reference]))
        compared.append(each)
    by_kind = {kind: _mean_error(*np.hstack(each)) for kind, each in of_parts.items()}
    lit = np.array([parts.mean() for parts in patterns])
    return Estimate(**by_kind, indirect=_indirect_error(compared, lit))


def _noise_of(held: Pictures) -> Double:
    """Variance of each pixel's noise, summed over channels, (pictures, M)."""
    known = held.measured
    stated = np.where(known, held.variance, 0).astype(np.float64)
    first, second = held.radiance[:2][..., known].astype(np.float64)
    spread = float(stated[:2].sum())
    scale = float(np.square(first - second).sum()) / spread if spread > 0 else 0.0
    return np.asarray(scale * stated.sum(axis=1))


def _compared(
    transport: Transport,
    parts: Bools,
    taken: Float,
    of_floodlit: Float,
    noise: Double,
    dark: Bools,
    known: Bools,
) -> _Comparison:
    """Compare a held-out picture (C, M) with a transport's pictures of its parts (parts, N).

    Errors of pixels with direct light belong to the part that lights them. Those of dark pixels are
    of all parts, by their shares.
    """
    noise, dark, taken = noise[known], dark[known], taken[:, known].astype(np.float64)
    predicted = relight_white(transport, parts)[..., known]
    together = predicted.sum(axis=0, dtype=np.float64)
    squares = np.square(together - taken).sum(axis=0) - noise
    shares, brightest = parts.mean(axis=1), predicted.sum(axis=1).argmax(axis=0)
    region = (brightest[:, None] == np.arange(len(parts))).astype(np.float64)
    belongs = np.where(dark[:, None], shares / shares.sum(), region)
    alone = _alone_over_together(
        parts.reshape(len(parts), RayDomain(transport.projector_shape).views, -1),
        float(np.square(of_floodlit[:, known], dtype=np.float64).sum()),
        float(squares.sum()),
    )
    light = np.square(predicted, dtype=np.float64).sum(axis=1)
    unpredicted = (np.square(taken) - np.square(together)).sum(axis=0) - noise
    return _Comparison(
        wrong=alone * (squares @ belongs),
        chance=alone * np.sqrt(2 * np.square(noise) @ belongs),
        light=light.sum(axis=1) + unpredicted @ region,
        dark_wrong=alone * squares[dark].sum() / len(parts),
        dark_chance=alone * float(np.sqrt(2 * np.square(noise[dark]).sum())) / len(parts),
        dark_light=light[:, dark].sum() / len(parts),
    )


def _alone_over_together(parts: Bools, of_floodlit: float, of_pattern: float) -> float:
    """Squared errors of parts alone, added up, over that of the pattern of them all.

    Parameters
    ----------
    parts : ndarray of bool, shape (parts, views, rays)
        Shares are those of each view: the floodlit picture of each is known.
    of_floodlit, of_pattern : float
        Squared errors of the floodlit picture and of the pattern's; noise may make the latter
        negative.
    """
    shares = parts.mean(axis=2)
    pattern = shares.sum(axis=0)
    spread = float((pattern * (1 - pattern)).sum())
    known = float((shares * (1 - shares)).sum()) / spread if spread > 0 else 1.0
    of_random = float(pattern.mean()) * of_floodlit
    independent = min(of_random / of_pattern, 1.0) if of_pattern > 0 else 0.0
    return known + (1 - known) * independent


def _indirect_error(compared: Sequence[_Comparison], lit: Double) -> float:
    """Estimate the mean error of indirect light, of patterns with a lit share."""
    of_dark = [(each.dark_wrong, each.dark_chance, each.dark_light) for each in compared]
    wrong, chance, light = np.array(of_dark).T
    reference = reference_light(light, typical_indirect(light, lit))
    kinds = np.array(HELD_OUT)
    chosen = (kinds == kind for kind in KINDS)
    errors = [_mean_error(wrong[own], chance[own], reference[own]) for own in chosen]
    return float(np.mean(errors))


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
