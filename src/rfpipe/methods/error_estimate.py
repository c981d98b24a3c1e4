"""Error estimate: the mean error of relit pictures, from held-out pictures that no fit uses.

Several bars or spots are the *parts* of one held-out pattern (`rfpipe.methods.held_out`). The error
of each part relit alone is computed from the error of their common picture.

===========  ========================  ============  ===============================================
symbol       name in the code          shape         meaning and unit
===========  ========================  ============  ===============================================
``e``                                  (C, pixels)   error of the pattern's relit picture, radiance
``e_i``                                (C, pixels)   error of part i relit alone; ``e = sum_i e_i``
``f``                                  (C, pixels)   error of the relit floodlit picture
``|e|^2``    `squared_error`           (pixels,)     squared error of each pixel, without noise; its
                                                     sum over the pixels is ``|e|^2``
``|e_i|^2``  `part_squared_error`      (parts,)      squared error of each part
``|f|^2``    `floodlit_squared_error`  scalar        squared error of the floodlit picture
``s_i``      `shares`                  (parts,)      share of the rays that part i lights
``s``        `share`                   scalar        share of the rays that the pattern lights; the
                                                     parts are disjoint, so that ``s = sum_i s_i``
``a``                                  scalar        sum of the squared errors of single rays
``b``                                  scalar        products of the errors of two rays
===========  ========================  ============  ===============================================

The floodlit picture is part of every fit, so that the errors of all N rays add up to f, which is
almost 0, and the errors of parts aren't independent. If the lit rays are a random sample of all
rays, e is the sum of a sample from a finite population [1]_. Its expected square is

    |e|^2 = a s + b s^2,    |e_i|^2 = a s_i + b s_i^2,    a + b = |f|^2

Without a and b,

    sum_i |e_i|^2 / |e|^2 = Q + (1 - Q) s |f|^2 / |e|^2,    Q = sum_i s_i (1 - s_i) / (s (1 - s))

The ratio is 1 where errors of rays are independent (b = 0), and Q where f is 0 (b = -a). On images
of 16 x 18, where bars and spots light a large share of the rays, Q is 1.4 to 1.7.

Light, other than errors, isn't random: parts light the pixels of one another, and ``|T p|^2``
exceeds ``sum_i |T p_i|^2``, to which errors are relative. The light of a part is therefore the
predicted light of the part alone, plus the measured minus the predicted light of its region.

References
----------
.. [1] W. G. Cochran, *Sampling Techniques*, 3rd ed., Wiley 1977, ch. 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpipe.array_types import Bools, Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.held_out import HELD_OUT, REPEATED, held_out_parts
from rfpipe.methods.images import Pictures, batches, relight_white
from rfpipe.relighting import KINDS, reference_light, typical_indirect
from rfpipe.transport.base import Transport

# Standard errors from which the pictures' variances are contradicted by the difference of two.
_NOISE_SIGNIFICANCE = 3.0


@dataclass(frozen=True)
class Estimate:
    """Estimated mean errors of relit pictures, see `rfpipe.relighting.relative_errors`.

    Attributes
    ----------
    shapes, bars, spots : float
        Mean errors of the three kinds of pictures, each relative to the root of `reference_light`:
        the picture's norm, or half the norm of a typical picture if that is larger.
    indirect : float
        Mean error on pixels without direct light, relative in the same way to the indirect light
        there; NaN if these pixels aren't known.
    """

    shapes: float
    bars: float
    spots: float
    indirect: float = np.nan

    @property
    def error(self) -> float:
        """Mean error over all kinds, one third each."""
        return (self.shapes + self.bars + self.spots) / 3


def estimate_error(
    transport: Transport, held_out: Pictures, floodlit: Float, dark: Bools
) -> Estimate:
    """Estimate a transport's mean error from the held-out pictures.

    Noise is subtracted: the variances of the pictures, scaled to the difference of the two pictures
    of one pattern where that contradicts them. Pixels that are unknown or saturated don't
    count.

    Parameters
    ----------
    transport : Transport
    held_out : Pictures
        Of the first `HELD_OUT_OF_PRIOR`, or all, of `held_out_patterns`, in their order.
    floodlit : ndarray of float32, shape (C, M)
    dark : ndarray of bool, shape (pictures, M)
        Pixels without direct light.
    """
    patterns = held_out_parts(transport.projector_shape)[: len(held_out.lit)]
    known = held_out.measured
    every_ray = np.ones((1, patterns[0].shape[1]), np.bool_)
    difference = relight_white(transport, every_ray)[0] - floodlit
    floodlit_squared_error = float(np.square(difference[:, known], dtype=np.float64).sum())
    noise = _noise_variance(held_out)
    comparisons = [
        _compare(
            transport,
            parts,
            _Picture(known, held_out.radiance[index], noise[index], dark[index]),
            floodlit_squared_error,
        )
        for index, parts in enumerate(patterns)
    ]
    full = float(np.square(floodlit[:, known], dtype=np.float64).sum())
    references = [
        reference_light(comparison.part_light, full * parts.mean(axis=1))
        for comparison, parts in zip(comparisons, patterns, strict=True)
    ]
    errors = {kind: _mean_error_of_kind(kind, comparisons, references) for kind in KINDS}
    lit = np.array([parts.mean() for parts in patterns])
    return Estimate(**errors, indirect=_indirect_error(comparisons, lit))


@dataclass(frozen=True)
class _Picture:
    """A held-out picture: known pixels (M,), radiance (C, M), noise variance (M,), dark (M,)."""

    known: Bools
    radiance: Float
    noise: Double
    dark: Bools


@dataclass(frozen=True)
class _Comparison:
    """Squared errors of a pattern's parts, as if each was relit alone.

    Attributes
    ----------
    part_squared_error : ndarray of float64, shape (parts,)
        ``|e_i|^2``. Noise is subtracted, which may make it negative.
    part_deviation : ndarray of float64, shape (parts,)
        Standard deviation of the squared error by noise.
    part_light : ndarray of float64, shape (parts,)
        Squared norm of the part's picture.
    dark_squared_error, dark_deviation, dark_light : float
        The same on pixels without direct light; means over the parts.
    """

    part_squared_error: Double
    part_deviation: Double
    part_light: Double
    dark_squared_error: float
    dark_deviation: float
    dark_light: float


def _noise_variance(held_out: Pictures) -> Double:
    """Estimate the variance of each pixel's noise, summed over channels, (pictures, M).

    The pictures' variances are scaled to the difference of the two pictures of one pattern, if both
    were taken, where it contradicts them: where their noise is mostly that of a few bright pixels,
    the difference is less certain than the variances of a calibrated camera.
    """
    known = held_out.measured
    stated = np.zeros(held_out.radiance.shape[::2])
    for total, image in zip(stated, held_out.variance, strict=True):
        total[known] = image[:, known].sum(axis=0, dtype=np.float64)
    if len(held_out.lit) <= max(REPEATED):
        return stated
    first, second = held_out.radiance[REPEATED][..., known]
    variance = held_out.variance[REPEATED][..., known].sum(axis=0, dtype=np.float64)
    expected = float(variance.sum())
    measured = float(np.square(np.subtract(first, second, dtype=np.float64)).sum())
    # the square of normal noise of the variance v has the variance 2 v^2
    deviation = float(np.sqrt(2 * np.square(variance).sum()))
    contradicts = abs(measured - expected) > _NOISE_SIGNIFICANCE * deviation
    stated *= measured / expected if contradicts and expected > 0 else 1.0
    return stated


def _compare(
    transport: Transport, parts: Bools, picture: _Picture, floodlit_squared_error: float
) -> _Comparison:
    """Compare a held-out picture with a transport's pictures of its parts (parts, N).

    The error of a pixel with direct light counts for the part that lights it; the error of a dark
    pixel counts for all parts, in proportion to their size.
    """
    known = picture.known
    noise, dark = picture.noise[known], picture.dark[known]
    measured = picture.radiance[:, known]
    predicted = _predicted(transport, parts, known, picture.dark)
    squared_error, unpredicted = -noise, -noise
    for total, light in zip(predicted.total, measured, strict=True):
        squared_error += np.square(total - light)
        unpredicted += np.square(light, dtype=np.float64) - np.square(total)
    shares, views = parts.mean(axis=1), RayDomain(transport.projector_shape).views
    shares_of_dark = shares / shares.sum()

    def by_part(values: Double) -> Double:
        """Sum up values of pixels for each part."""
        direct = np.where(dark, 0, values)
        counted = np.bincount(predicted.brightest, direct, len(parts))
        return np.asarray(counted + values[dark].sum() * shares_of_dark)

    ratio = _parts_over_pattern(
        parts.reshape(len(parts), views, -1), floodlit_squared_error, float(squared_error.sum())
    )
    return _Comparison(
        part_squared_error=ratio * by_part(squared_error),
        part_deviation=ratio * np.sqrt(2 * by_part(np.square(noise))),
        part_light=predicted.light + np.bincount(predicted.brightest, unpredicted, len(parts)),
        dark_squared_error=ratio * squared_error[dark].sum() / len(parts),
        dark_deviation=ratio * float(np.sqrt(2 * np.square(noise[dark]).sum())) / len(parts),
        dark_light=predicted.dark_light / len(parts),
    )


class _Predicted(NamedTuple):
    """Relit pictures of the parts of a pattern, on m known pixels.

    Attributes
    ----------
    total : ndarray of float64, shape (C, m)
        Sum of the pictures.
    brightest : ndarray of int64, shape (m,)
        Number of the part that lights each pixel most.
    light : ndarray of float64, shape (parts,)
        Squared norm of each picture.
    dark_light : float
        Squared norm of all pictures on the pixels without direct light.
    """

    total: Double
    brightest: Index
    light: Double
    dark_light: float


def _predicted(transport: Transport, parts: Bools, known: Bools, dark: Bools) -> _Predicted:
    """Relight the parts (parts, N) of a pattern, a few at a time.

    `known` and `dark`, (M,), are the known pixels, and those without direct light.
    """
    from rfpipe.methods.estimate_kernels import RelitParts, add_part

    pixels = known.size
    relit = RelitParts(
        np.zeros((transport.channels, pixels)),
        np.zeros(pixels, np.int64),
        np.full(pixels, -np.inf, np.float32),
    )
    light, dark_light = np.zeros(len(parts)), 0.0
    for first, last in batches(len(parts), transport.channels * max(pixels, parts.shape[1])):
        for part, picture in enumerate(relight_white(transport, parts[first:last]), first):
            light[part], light_on_dark = add_part(relit, part, picture, known, dark)
            dark_light += light_on_dark
    return _Predicted(relit.total[:, known], relit.brightest[known], light, dark_light)


def _parts_over_pattern(parts: Bools, floodlit_squared_error: float, squared_error: float) -> float:
    """Compute ``sum_i |e_i|^2 / |e|^2``, the squared errors of the parts over the pattern's.

    It is ``Q + (1 - Q) r`` with ``r = min(s |f|^2 / |e|^2, 1)``, see the module. Independent errors
    of rays have r = 1, to which r is limited. Where noise makes ``|e|^2`` negative, r is 0.

    Parameters
    ----------
    parts : ndarray of bool, shape (parts, views, rays)
        Disjoint parts. The sums in Q are also over the views, with shares of the rays of a view,
        since the floodlit picture of each view is known.
    floodlit_squared_error, squared_error : float
        ``|f|^2`` and ``|e|^2``; noise may make the latter negative.
    """
    shares = parts.mean(axis=2)
    share = shares.sum(axis=0)
    variance = float((share * (1 - share)).sum())
    q = float((shares * (1 - shares)).sum()) / variance if variance > 0 else 1.0
    independent_error = float(share.mean()) * floodlit_squared_error
    r = min(independent_error / squared_error, 1.0) if squared_error > 0 else 0.0
    return q + (1 - q) * r


def _mean_error_of_kind(
    kind: str, comparisons: Sequence[_Comparison], references: Sequence[Double]
) -> float:
    """Estimate the mean error of all parts of a kind of pictures."""
    columns = [
        np.stack([comparison.part_squared_error, comparison.part_deviation, reference])
        for name, comparison, reference in zip(HELD_OUT, comparisons, references, strict=False)
        if name == kind
    ]
    return _mean_error(*np.hstack(columns))


def _indirect_error(comparisons: Sequence[_Comparison], lit: Double) -> float:
    """Estimate the mean error of indirect light.

    `lit`, (patterns,), is the mean lit share of a part of each pattern.
    """
    columns = [(it.dark_squared_error, it.dark_deviation, it.dark_light) for it in comparisons]
    squared_error, deviation, light = np.array(columns).T
    reference = reference_light(light, typical_indirect(light, lit))
    kinds = np.array(HELD_OUT[: len(comparisons)])
    masks = (kinds == kind for kind in KINDS)
    return float(
        np.mean([_mean_error(squared_error[m], deviation[m], reference[m]) for m in masks])
    )


def _mean_error(squared_error: Double, deviation: Double, reference: Double) -> float:
    """Estimate the mean relative error of parts.

    Noise makes the mean of roots too large; differences between parts make the root of the mean too
    large. The smaller of the two is used, but at least the error that noise could hide.

    Parameters
    ----------
    squared_error : ndarray of float64, shape (parts,)
        Squared errors, which noise may make negative.
    deviation : ndarray of float64, shape (parts,)
        Their standard deviations by noise.
    reference : ndarray of float64, shape (parts,)
        Squared light to which they are relative. Parts without light don't count.
    """
    is_lit = reference > 0
    relative, noise = (
        squared_error[is_lit] / reference[is_lit],
        deviation[is_lit] / reference[is_lit],
    )
    if not relative.size:
        return 0.0
    mean_of_roots = float(np.sqrt(relative.clip(0)).mean())
    root_of_mean = float(np.sqrt(max(float(relative.mean()), 0.0)))
    hidden_by_noise = float(np.linalg.norm(noise)) / relative.size
    return max(min(mean_of_roots, root_of_mean), float(np.sqrt(hidden_by_noise)))
