"""The pictures that people relight, and the error of a relit one: one definition for all tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator

Bools = NDArray[np.bool_]
Double = NDArray[np.float64]

KINDS = ("shapes", "bars", "spots")
"""Kinds of relit pictures, a third each."""

_LEAST = 0.5  # of the light that a picture sends back typically, what errors are relative to


def relighting_pictures(shape: tuple[int, ...], count: int, seed: int = 0) -> NDArray[np.float32]:
    """Draw pictures from the distribution of those that people relight.

    In turn: shapes of all scales, lit over a tenth to six tenths of the image; bars and half planes
    of any direction; one square spot, its side log-uniform from two pixels to an eighth of the
    image's shorter side. Fewer are the first of more. Of a stack, every other picture of a kind
    lights one view alone, the others all views alike.

    Parameters
    ----------
    shape : tuple of int
        A ray domain's, (H, W) or (V, H, W).
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
        If the shape isn't one of a ray domain.
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
    """Return noise with unit deviation, on the torus, float64 (*shape).

    Amplitudes fall with the power `falloff` of the frequency: 1 has equal power in every octave, 0
    is white.
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


def brightest(image: NDArray[np.floating[Any]], part: float) -> Bools:
    """Return the part of an image that is brightest; of equal pixels, the first."""
    count = max(1, round(part * image.size))
    chosen = np.zeros(image.size, np.bool_)
    chosen[np.argsort(-image.ravel(), kind="stable")[:count]] = True
    return chosen.reshape(image.shape)


def shapes(shape: tuple[int, int], random: np.random.Generator, lit: float | None = None) -> Bools:
    """Draw random shapes of all scales, over a tenth to six tenths of the image, or `lit` of it."""
    return brightest(octave_noise(shape, random), random.uniform(0.1, 0.6) if lit is None else lit)


def bar(shape: tuple[int, int], random: np.random.Generator) -> Bools:
    """Draw a bar, two pixels to half the image wide, or, as often, a half plane."""
    place = across(shape, random.uniform(0, 2 * np.pi))
    middle = place.ravel()[random.integers(place.size)]
    if random.random() < 0.5:
        return np.asarray(place >= middle)
    wide = _between(2, max(2.0, min(shape) / 2), random.random())
    return np.asarray(np.abs(place - middle) <= wide / 2)


def across(shape: tuple[int, int], angle: float) -> Double:
    """Return each pixel's place, in pixels, along a direction: its angle from the rows, radians."""
    row, column = np.indices(shape)
    place: Double = row * np.sin(angle) + column * np.cos(angle)
    return place


def spot(shape: tuple[int, int], random: np.random.Generator, size: float | None = None) -> Bools:
    """Draw a square spot of any size, or of one from 0, the smallest, to 1, the largest."""
    height, width = shape
    size = random.random() if size is None else size
    side = min(round(_between(2, max(2.0, min(shape) / 8), size)), height, width)
    top, left = random.integers(0, height - side + 1), random.integers(0, width - side + 1)
    drawn = np.zeros(shape, np.bool_)
    drawn[top : top + side, left : left + side] = True
    return drawn


def _between(least: float, most: float, share: float) -> float:
    """Return a length between two, by the share of their ratio's logarithm."""
    return float(least * (most / least) ** share)


def reference_light(light: Double, typical: Double | float) -> Double:
    """Return the squared light that a picture's squared error is relative to.

    That is the picture's own, or a quarter of the typical where that is more: next to black,
    relative to nothing, everything would be wrong.

    Parameters
    ----------
    light : ndarray of float64
        Summed squares of a picture's light; noise may make it negative.
    typical : ndarray of float64, or float
        Summed squares of the light that as many lit pixels send back on average:
        ``|F|^2 |p|^2 / N``, F the floodlit image and p the pattern on N pixels.
    """
    return np.maximum(light, _LEAST**2 * np.asarray(typical))


@dataclass(frozen=True, eq=False)
class Squares:
    """Summed squares of P relit pictures, of all rays or of those without direct light.

    Attributes
    ----------
    wrong : ndarray of float64, shape (P,) or (L, P)
        Of the difference between relit pictures and truth.
    light : ndarray of float64, shape (P,)
        Of the truth.
    typical : ndarray of float64, shape (P,)
        Of the light that as many lit pixels send back on average.
    """

    wrong: Double
    light: Double
    typical: Double

    @property
    def errors(self) -> Double:
        """Norms of the difference over `reference_light`; 0 where that is nought."""
        return relative_errors(self.wrong, reference_light(self.light, self.typical))

    @property
    def plain_errors(self) -> Double:
        """Norms of the difference over those of the pictures; 0 of a picture without light."""
        return relative_errors(self.wrong, self.light)


def picture_errors(
    images: Iterable[NDArray[Any]],
    truth: Iterable[NDArray[Any]],
    patterns: NDArray[Any],
    floodlit: NDArray[Any],
    dark: Bools | None = None,
) -> tuple[Double, Double]:
    """Return the errors of relit pictures, in total and of their indirect light.

    Norms of the difference, over `reference_light`; 0 where that is nought.

    Parameters
    ----------
    images, truth, patterns, floodlit, dark
        As of `picture_squares`.

    Returns
    -------
    total : ndarray of float64, shape (P,) or (L, P)
    indirect : ndarray of float64, of the same shape
        On the dark pixels alone, of the light there; NaN where `dark` isn't given.
    """
    total, indirect = picture_squares(images, truth, patterns, floodlit, dark)
    errors = total.errors
    return errors, np.full(errors.shape, np.nan) if indirect is None else indirect.errors


def picture_squares(
    images: Iterable[NDArray[Any]],
    truth: Iterable[NDArray[Any]],
    patterns: NDArray[Any],
    floodlit: NDArray[Any],
    dark: Bools | None = None,
) -> tuple[Squares, Squares | None]:
    """Sum the squares that errors of relit pictures are made of.

    Parameters
    ----------
    images : iterable of P ndarray, shape (*camera_shape, C) or (L, *camera_shape, C)
        Radiance, of one transport or of L.
    truth : iterable of P ndarray, shape (*camera_shape, C)
    patterns : ndarray, shape (P, *projector_shape)
    floodlit : ndarray, shape (*camera_shape, C)
        The true radiance of the floodlit scene.
    dark : ndarray of bool, shape (P, *camera_shape), optional
        The pixels that get no direct light, where these are known.

    Returns
    -------
    total : Squares
    indirect : Squares or None
        On the dark pixels alone; None where `dark` isn't given. What pictures send there typically
        is their mean, for as many lit pixels.
    """
    count = len(patterns)
    lit = np.square(patterns, dtype=np.float64).mean(axis=tuple(range(1, patterns.ndim)))
    wrong, light = [], np.zeros((2, count))
    for index, (image, true) in enumerate(zip(images, truth, strict=True)):
        error = np.square(np.subtract(image, true, dtype=np.float64)).sum(axis=-1)
        own = np.square(true, dtype=np.float64).sum(axis=-1)
        where = np.ones(own.shape, np.bool_) if dark is None else dark[index]
        rays = tuple(range(-own.ndim, 0))
        wrong.append((error.sum(axis=rays), error[..., where].sum(axis=-1)))
        light[:, index] = own.sum(), own[where].sum()
    full = float(np.square(floodlit, dtype=np.float64).sum())
    of_all, of_dark = np.moveaxis(np.array(wrong), 0, -1) if count else np.zeros((2, 0))
    total = Squares(of_all, light[0], full * lit)
    if dark is None:
        return total, None
    return total, Squares(of_dark, light[1], typical_indirect(light[1], lit))


def relative_errors(wrong: Double, reference: Double) -> Double:
    """Return roots of squared errors, which noise may make negative, over a reference; 0 of 0."""
    ratio = np.zeros(wrong.shape)
    np.divide(np.maximum(wrong, 0), reference, out=ratio, where=reference > 0)
    return np.sqrt(ratio)


def typical_indirect(light: Double, lit: Double) -> Double:
    """Return what pictures send to their dark pixels typically, by the share that they light."""
    shares = np.divide(light, lit, out=np.zeros(light.shape), where=lit > 0)
    return lit * shares.mean() if shares.size else shares
