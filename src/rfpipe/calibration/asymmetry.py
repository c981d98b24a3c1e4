"""What makes a rig asymmetric: flare and unequal vignetting, from the pictures that show it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry import Resampling
from rfpipe.photometry.symmetry import Pictures, Symmetry, measure_symmetry

__all__ = ["Causes", "find_causes", "squared_radius"]

Double = NDArray[np.float64]

SURE = 3.0
"""Standard errors from which on a cause is one."""

LEAST = 0.003
"""Flare or vignetting, fractions, below which they are not worth a word."""


MOST = 0.6
"""Flare or vignetting that a fit is believed; more is another thing that grows outwards."""


@dataclass(frozen=True)
class Causes:
    """Flare and vignetting, and the errors that they bring to symmetric photography; fractions.

    Attributes
    ----------
    flare, flare_error : float
        Light that the lens spreads evenly over the picture; its standard error.
    vignetting, vignetting_error : float
        Light lost in the camera's corners beyond what the projector loses in its own.
    flare_makes, vignetting_makes : float
        Relative error of relit pictures by each; 0 where it isn't significant.
    rest : Symmetry
        What is left without them.
    """

    flare: float
    flare_error: float
    vignetting: float
    vignetting_error: float
    flare_makes: float
    vignetting_makes: float
    rest: Symmetry

    @property
    def has_flare(self) -> bool:
        """Whether flare is significant."""
        return max(SURE * self.flare_error, LEAST) < self.flare < MOST

    @property
    def has_vignetting(self) -> bool:
        """Whether vignetting is significant."""
        return max(SURE * self.vignetting_error, LEAST) < self.vignetting < MOST


def squared_radius(resampling: Resampling) -> tuple[Double, float]:
    """Return each ray's squared distance from the picture's middle, and the rays' share of it.

    Returns
    -------
    ndarray of float64, shape (N,)
        1 in the corners of the camera's picture.
    float
        Share of the camera's pixels that look at rays.
    """
    height, width = resampling.camera_shape
    y, x = np.arange(height) - (height - 1) / 2, np.arange(width) - (width - 1) / 2
    radius = np.square(y)[:, None] + np.square(x)[None]
    of_rays = np.asarray(resampling.matrix @ (radius / max(radius[0, 0], 1)).ravel())
    looking = np.count_nonzero(np.asarray(abs(resampling.matrix).sum(axis=0)) > 0)
    return of_rays, looking / prod(resampling.camera_shape)


def find_causes(
    floodlit: Double, variance: Double, pictures: list[Pictures], resampling: Resampling
) -> Causes:
    """Fit flare and vignetting to the asymmetry of pictures under random patterns.

    Parameters as `measure_symmetry`, and the resampling that the pictures came through.

    Notes
    -----
    With flare f and a falloff 1 / (1 + b r^2), r from the picture's middle, the camera shows
    ``c' = c / (1 + b r^2) + f mean(c)`` for each picture c. Reciprocity of c, for signs s1 and s2,
    makes ``s2 c1' - s1 c2' = f (1 s2 mean(c1) - 1 s1 mean(c2)) - b (r^2 s2 c1' - r^2 s1 c2')``
    to first order: linear in both, and all else is known from the pictures. Patterns of single
    rays are left out where there are coarser ones: blur and misalignment bend those most.
    """
    radius, share = squared_radius(resampling)
    coarse = [one for one in pictures if one.side > 1] or pictures
    signs = np.concatenate([np.ones((1, len(radius))), *(one.signs for one in coarse)])
    images = np.concatenate([floodlit[None], *(one.images for one in coarse)])
    noise = np.concatenate([variance[None], *(one.noise for one in coarse)])
    i, j = np.triu_indices(len(signs), 1)

    def apart(weight: Double) -> Double:
        """Return what each pair of pictures differs by, its rays weighed, (pairs * C,)."""
        seen = np.einsum("jn,inc->jic", signs * weight, images)
        return np.asarray(seen[j, i] - seen[i, j]).ravel()

    def spread(weight: Double) -> Double:
        own = np.einsum("inc,n->ic", noise, weight)
        return np.asarray(own[i] + own[j]).ravel()

    sums, means = signs.sum(axis=1)[:, None], share * images.mean(axis=1)
    even = (sums[j] * means[i] - sums[i] * means[j]).ravel()
    one = np.ones_like(radius)
    fitted = _fit(apart(one), even, -apart(radius), spread(one), spread(radius), spread(radius**2))
    (flare, slope), (flare_error, slope_error) = fitted
    vignetting, vignetting_error = slope / (1 + max(slope, 0.0)), slope_error
    as_it_is = measure_symmetry(floodlit, variance, pictures)
    is_flare = max(SURE * flare_error, LEAST) < flare < MOST
    is_vignetting = max(SURE * vignetting_error, LEAST) < vignetting < MOST
    f, b = flare * is_flare, slope * is_vignetting
    factor = 1 + b * radius[:, None]

    def without(f: float, factor: Double | float) -> Symmetry:
        def mended(images: Double) -> Double:
            return np.asarray((images - f * share * images.mean(axis=-2, keepdims=True)) * factor)

        parts = [replace(p, images=mended(p.images), noise=p.noise * factor**2) for p in pictures]
        return measure_symmetry(mended(floodlit), variance * factor**2, parts)

    rest = without(f, factor) if f or b else as_it_is
    return Causes(
        float(flare),
        float(flare_error),
        float(vignetting),
        float(vignetting_error),
        _made(without(0.0, factor), rest) if is_flare else 0.0,
        _made(without(f, 1.0), rest) if is_vignetting else 0.0,
        rest,
    )


def _fit(
    y: Double, even: Double, falling: Double, variance: Double, shared: Double, own: Double
) -> tuple[Double, Double]:
    """Fit y = f even + b falling; return f and b, and their errors by the true spread.

    `falling` is made of the same noisy pictures as y: its noise has the variance `own`, and with
    that of y, of variance `variance`, the covariance -`shared`. Both are taken out of the sums.
    """
    weight = 1 / np.maximum(variance, float(np.finfo(np.float64).tiny))
    x = np.stack([even, falling], axis=1)
    normal = x.T @ (weight[:, None] * x)
    normal[1, 1] = max(normal[1, 1] - float(weight @ own), 1e-3 * normal[1, 1])
    inverse = np.linalg.pinv(normal)
    found = inverse @ (x.T @ (weight * y) + [0.0, float(weight @ shared)])
    rest = y - x @ found
    excess = max(1.0, float(weight @ rest**2) / max(len(y) - 2, 1))
    return found, np.sqrt(np.maximum(np.diag(inverse), 0) * excess)


def _made(more: Symmetry, less: Symmetry) -> float:
    """Return the error that a cause makes: what pictures have with it beyond what without it."""
    pairs = zip(more.scales, less.scales, strict=True)
    return max(float(np.sqrt(max(a.predicted**2 - b.predicted**2, 0))) for a, b in pairs)
