"""Distribution of relit pictures, and the definition of their error for all tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double
from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator

KINDS = ("shapes", "bars", "spots")
"""Kinds of relit pictures, one third each."""

# Least norm that errors are relative to, over the typical norm of a picture of as many lit pixels.
_LEAST_REFERENCE = 0.5


def relighting_pictures(shape: tuple[int, ...], count: int, seed: int = 0) -> NDArray[np.float32]:
    """Draw pictures from the distribution on which errors are defined.

    In turn: shapes of all scales that cover 10 to 60 % of the image; bars and half planes of any
    direction; one square spot, its side log-uniform from two pixels to an eighth of the image's
    shorter side. A smaller `count` gives the first pictures of a larger one. With several views,
    every second picture of a kind lights a single view, the others light all views equally.

    Parameters
    ----------
    shape : tuple of int
        A ray domain, (H, W) or (V, H, W).
    count : int
        At least 0.
    seed : int

    Returns
    -------
    ndarray of float32, shape (count, *shape)
        0 or 1.

    Raises
    ------
    InputError
        If the shape is not a ray domain.
    """
    domain = RayDomain(shape)
    drawn = np.zeros((count, *domain.stack_shape), np.float32)
    draw = (shapes, bar, spot)
    for index in range(count):
        random = generator(seed, index)
        picture = draw[index % len(draw)](domain.image_shape, random)
        view = random.integers(domain.views) if index // len(draw) % 2 else slice(None)
        drawn[index, view] = picture
    return drawn.reshape(count, *shape)


def octave_noise(
    shape: tuple[int, ...], random: np.random.Generator, falloff: float = 1.0
) -> NDArray[np.float64]:
    """Draw periodic noise of standard deviation 1, float64 (*shape).

    Amplitudes fall with the power `falloff` of the frequency: 1 has equal power in each octave, 0
    is white noise.
    """
    height, width = RayDomain(shape).image_shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    amplitude = 1 / np.maximum(frequency, 1 / max(height, width)) ** falloff
    amplitude[0, 0] = 0
    white = np.fft.rfft2(random.standard_normal(shape))
    field = np.fft.irfft2(white * amplitude, s=(height, width), axes=(-2, -1))
    spread = field.std()
    # a single ray has no detail
    noise: NDArray[np.float64] = field / spread if spread > 0 else random.standard_normal(shape)
    return noise


def brightest(image: NDArray[np.floating[Any]], share: float) -> Bools:
    """Select the brightest share of the pixels, of equal pixels the first."""
    count = max(1, round(share * image.size))
    chosen = np.zeros(image.size, np.bool_)
    chosen[np.argsort(-image.ravel(), kind="stable")[:count]] = True
    return chosen.reshape(image.shape)


def shapes(shape: tuple[int, int], random: np.random.Generator, lit: float | None = None) -> Bools:
    """Draw random shapes of all scales that cover 10 to 60 % of the image, or the share `lit`."""
    return brightest(octave_noise(shape, random), random.uniform(0.1, 0.6) if lit is None else lit)


def bar(shape: tuple[int, int], random: np.random.Generator) -> Bools:
    """Draw a bar, 2 pixels to half the image wide, or with probability 1/2 a half plane."""
    position = position_along(shape, random.uniform(0, 2 * np.pi))
    centre = position.ravel()[random.integers(position.size)]
    if random.random() < 0.5:
        return np.asarray(position >= centre)
    width = _log_interpolate(2, max(2.0, min(shape) / 2), random.random())
    return np.asarray(np.abs(position - centre) <= width / 2)


def position_along(shape: tuple[int, int], angle: float) -> Double:
    """Compute the position of each pixel along a direction at `angle` radians, in pixels."""
    row, column = np.indices(shape)
    position: Double = row * np.sin(angle) + column * np.cos(angle)
    return position


def spot(shape: tuple[int, int], random: np.random.Generator) -> Bools:
    """Draw a square spot of random size."""
    drawn = np.zeros(shape, np.bool_)
    drawn[spot_place(shape, random, random.random())] = True
    return drawn


def spot_place(
    shape: tuple[int, int], random: np.random.Generator, size: float
) -> tuple[slice, slice]:
    """Draw the rows and columns of a square spot of `size` from 0, the smallest, to 1."""
    height, width = shape
    side = min(round(_log_interpolate(2, max(2.0, min(shape) / 8), size)), height, width)
    top = int(random.integers(0, height - side + 1))
    left = int(random.integers(0, width - side + 1))
    return slice(top, top + side), slice(left, left + side)


def _log_interpolate(first: float, last: float, share: float) -> float:
    """Interpolate between two lengths on a logarithmic scale; share 0 is the first."""
    return float(first * (last / first) ** share)


def reference_light(light: Double, typical: Double | float) -> Double:
    """Compute the squared norm that the squared error of a picture is relative to.

    It is the squared norm of the picture, but at least a quarter of the typical one, so that nearly
    black pictures don't have arbitrarily large errors.

    Parameters
    ----------
    light : ndarray of float64
        Squared norm of each picture; estimates may be negative because of noise.
    typical : ndarray of float64, or float
        Mean squared norm of pictures with as many lit pixels: ``|F|^2 |p|^2 / N``, where F is the
        floodlit image and p the pattern on N pixels.
    """
    return np.maximum(light, _LEAST_REFERENCE**2 * np.asarray(typical))


@dataclass(frozen=True, eq=False)
class SquaredNorms:
    """Squared norms of P relit pictures, over all rays or those without direct light.

    Attributes
    ----------
    difference : ndarray of float64, shape (P,) or (L, P)
        Of the difference between relit pictures and the truth.
    light : ndarray of float64, shape (P,)
        Of the truth.
    typical : ndarray of float64, shape (P,)
        Of pictures with as many lit pixels, on average; see `reference_light`.
    """

    difference: Double
    light: Double
    typical: Double

    @property
    def errors(self) -> Double:
        """Norm of the difference relative to the root of `reference_light`; 0 where that is 0."""
        return relative_errors(self.difference, reference_light(self.light, self.typical))

    @property
    def plain_errors(self) -> Double:
        """Norm of the difference relative to the norm of the picture; 0 for a black picture."""
        return relative_errors(self.difference, self.light)


def picture_errors(
    images: Iterable[NDArray[Any]],
    truth: Iterable[NDArray[Any]],
    patterns: NDArray[Any],
    floodlit: NDArray[Any],
    dark: Bools | None = None,
) -> tuple[Double, Double]:
    """Errors of relit pictures, in total and of their indirect light.

    An error is the norm of the difference relative to the root of `reference_light`; 0 where that
    is 0.

    Parameters
    ----------
    images, truth, patterns, floodlit, dark
        As of `picture_squared_norms`.

    Returns
    -------
    total : ndarray of float64, shape (P,) or (L, P)
    indirect : ndarray of float64, of the same shape
        On the dark pixels, relative to the light there; NaN if `dark` is None.
    """
    total, indirect = picture_squared_norms(images, truth, patterns, floodlit, dark)
    errors = total.errors
    return errors, np.full(errors.shape, np.nan) if indirect is None else indirect.errors


def picture_squared_norms(
    images: Iterable[NDArray[Any]],
    truth: Iterable[NDArray[Any]],
    patterns: NDArray[Any],
    floodlit: NDArray[Any],
    dark: Bools | None = None,
) -> tuple[SquaredNorms, SquaredNorms | None]:
    """Compute the squared norms from which errors of relit pictures are computed.

    Parameters
    ----------
    images : iterable of P ndarray, shape (*camera_shape, C) or (L, *camera_shape, C)
        Radiance, of one transport or of L.
    truth : iterable of P ndarray, shape (*camera_shape, C)
    patterns : ndarray, shape (P, *projector_shape)
    floodlit : ndarray, shape (*camera_shape, C)
        The true radiance of the floodlit scene.
    dark : ndarray of bool, shape (P, *camera_shape), optional
        Pixels without direct light.

    Returns
    -------
    total : SquaredNorms
    indirect : SquaredNorms or None
        On the dark pixels; None if `dark` is None. The typical light is the mean of the pictures
        there, for as many lit pixels.
    """
    count = len(patterns)
    lit = np.square(patterns, dtype=np.float64).mean(axis=tuple(range(1, patterns.ndim)))
    differences, light = [], np.zeros((2, count))
    for index, (image, true) in enumerate(zip(images, truth, strict=True)):
        error = np.square(np.subtract(image, true, dtype=np.float64)).sum(axis=-1)
        square = np.square(true, dtype=np.float64).sum(axis=-1)
        chosen = np.ones(square.shape, np.bool_) if dark is None else dark[index]
        rays = tuple(range(-square.ndim, 0))
        differences.append((error.sum(axis=rays), error[..., chosen].sum(axis=-1)))
        light[:, index] = square.sum(), square[chosen].sum()
    full = float(np.square(floodlit, dtype=np.float64).sum())
    all_rays, dark_rays = np.moveaxis(np.array(differences), 0, -1) if count else np.zeros((2, 0))
    total = SquaredNorms(all_rays, light[0], full * lit)
    if dark is None:
        return total, None
    return total, SquaredNorms(dark_rays, light[1], typical_indirect(light[1], lit))


def relative_errors(squared_error: Double, reference: Double) -> Double:
    """Compute ``sqrt(squared_error / reference)``; 0 where either is 0 or, by noise, negative."""
    ratio = np.zeros(squared_error.shape)
    np.divide(np.maximum(squared_error, 0), reference, out=ratio, where=reference > 0)
    return np.sqrt(ratio)


def typical_indirect(light: Double, lit: Double) -> Double:
    """Typical squared norm of a picture on its dark pixels, for each pattern.

    It is proportional to the pattern's lit share: the mean of ``light / lit`` over all pictures,
    times `lit`.

    Parameters
    ----------
    light : ndarray of float64, shape (P,)
        Squared norms of pictures on their dark pixels.
    lit : ndarray of float64, shape (P,)
        Lit share of each pattern.
    """
    shares = np.divide(light, lit, out=np.zeros(light.shape), where=lit > 0)
    return lit * shares.mean() if shares.size else shares
