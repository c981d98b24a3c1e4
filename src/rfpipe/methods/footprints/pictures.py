"""Pictures of the patterns on one projector view, pixel by pixel.

Footprints are recognised by the radiance of a camera pixel over all patterns. In these arrays each
row is a camera pixel and each column a picture; in `rfpipe.methods.images` each row is a picture.

A fit of a light field goes through all pictures many times, view by view. They are kept in a packed
form of 3 bytes a value, radiance as float16 and the logarithm of the variance in 8 bits, and are
unpacked for one view at a time. The rounding of the radiance, 0.02 %, is a tenth of the error that
any fit assumes of its model; that of the variance is 6 %.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.base import SIGNIFICANCE
from rfpipe.methods.images import Pictures
from rfpipe.ranges import ranges

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Errors of any model, relative to the floodlit image of the pixel and to its mean over all pixels.
_MODEL_ERROR, _LEAST_ERROR = 0.002, 1e-5
# Codes of variances: steps of an octave, and the code of a variance of 1.
_STEPS, _ONE = 6, 200
_UNKNOWN = 255
_VARIANCES = np.exp2((np.arange(256) - _ONE) / _STEPS).astype(np.float32)
_VARIANCES[_UNKNOWN] = np.inf
_LARGEST = float(np.finfo(np.float16).max)
# Camera pixels, and values, that are unpacked at a time.
_MOST_PIXELS, _MOST_VALUES = 2**17, 2**24


class ViewPictures(ABC):
    """Pictures of one channel, or of the sum of channels; the first is the floodlit one.

    M is the number of camera pixels, N the number of projector pixels of the view, P the number of
    pictures of patterns on the view.

    Attributes
    ----------
    patterns : ndarray of float32, shape (N, P)
        p: weight of each projector pixel in each pattern, 0 to 1.
    radiance : ndarray of float32, shape (M, P)
        c, 0 where a pixel is unknown.
    variance : ndarray of float32, shape (M, P)
        Infinite where a pixel is unknown.
    """

    patterns: Float
    radiance: Float
    variance: Float

    @abstractmethod
    def first(self) -> tuple[Float, Float]:
        """Return radiance and variance of the floodlit picture, (M,) each."""

    @abstractmethod
    def at(self, camera_pixels: slice | Index | None) -> ViewArrays:
        """Select camera pixels by their numbers; None selects all."""

    def ranges(self) -> list[tuple[int, int]]:
        """Divide the camera pixels into ranges ``(first, last + 1)`` to unpack at a time."""
        count = self.patterns.shape[1]
        return ranges(len(self.first()[0]), max(1, min(_MOST_PIXELS, _MOST_VALUES // count)))

    @property
    def floodlit(self) -> Float:
        """Floodlit image, at least 0, (M,)."""
        return np.maximum(self.first()[0], 0)

    @property
    def known(self) -> Bools:
        """Pixels with finite variance, the same in all pictures, (M,)."""
        return np.asarray(np.isfinite(self.first()[1]))

    @property
    def lit_pixels(self) -> Bools:
        """Pixels whose floodlit radiance exceeds 3 standard deviations of noise, (M,)."""
        radiance, variance = self.first()
        known = np.isfinite(variance)
        noise = np.sqrt(np.where(known, variance, 0))
        return np.asarray(known & (radiance > SIGNIFICANCE * noise))

    def has_light(self) -> bool:
        """Return True if the sum of the floodlit image exceeds 3 standard deviations of noise."""
        radiance, variance = self.first()
        known = np.isfinite(variance)
        light = float(radiance[known].sum(dtype=np.float64))
        noise = float(np.sqrt(variance[known].sum(dtype=np.float64)))
        return light > SIGNIFICANCE * noise

    def inverse_variance(self, model_error: float = 0.0) -> Float:
        """Compute the inverse variance of the difference between picture and model, (M, P).

        It is 0 for masked pixels. The variance includes errors of the model: 0.2 % of the floodlit
        image, `model_error` of the floodlit image, and 1e-5 of its mean over these pixels.
        """
        floodlit = self.floodlit[:, None]
        least = _LEAST_ERROR * float(floodlit.mean(dtype=np.float64)) if len(floodlit) else 0.0
        model_variance = (_MODEL_ERROR**2 + model_error**2) * np.square(floodlit) + least**2
        precision: Float = (1 / (self.variance + model_variance)).astype(np.float32)
        return precision

    def relative_noise(self) -> float:
        """Compute the median over pixels of the variance of a picture over squared floodlit light.

        It is 1 if no pixel is lit.
        """
        # the floodlit picture itself counts only if there is no other
        first, noise = int(self.patterns.shape[1] > 1), []
        for begin, end in self.ranges():
            part = self.at(slice(begin, end))
            lit = part.lit_pixels
            variance = part.variance[lit, first:].mean(axis=1)
            noise.append(variance / np.square(part.floodlit[lit]))
        relative = np.concatenate(noise)
        return float(np.median(relative)) if len(relative) else 1.0


@dataclass(frozen=True)
class ViewArrays(ViewPictures):
    """Pictures of one projector view as arrays, see `ViewPictures`."""

    patterns: Float
    radiance: Float
    variance: Float

    def first(self) -> tuple[Float, Float]:
        """Return radiance and variance of the floodlit picture, (M,) each."""
        return self.radiance[:, 0], self.variance[:, 0]

    def at(self, camera_pixels: slice | Index | None) -> ViewArrays:
        """Select camera pixels by their numbers; None selects all."""
        if camera_pixels is None:
            return self
        return ViewArrays(self.patterns, self.radiance[camera_pixels], self.variance[camera_pixels])


@dataclass(frozen=True)
class PackedPictures:
    """Packed pictures of on-off patterns, of all channels.

    Attributes
    ----------
    lit : ndarray of uint8, shape (P, ceil(N / 8))
        The patterns, a bit for each of N projector rays.
    radiance : ndarray of float16, shape (P, C, M)
        In the unit of the fit; 0 where a pixel is unknown.
    variance : ndarray of uint8, shape (P, C, M)
        Logarithm of the variance in sixths of an octave, see `_VARIANCES`.
    """

    lit: NDArray[np.uint8]
    radiance: NDArray[np.float16]
    variance: NDArray[np.uint8]

    @classmethod
    def of(cls, pictures: Pictures, unit: float) -> PackedPictures:
        """Pack pictures, with radiance divided by a unit."""
        known = np.isfinite(pictures.variance)
        radiance = np.where(known, pictures.radiance / np.float32(unit), 0)
        variance = np.where(known, pictures.variance / np.float32(unit) / np.float32(unit), 1)
        code = np.log2(np.maximum(variance, _VARIANCES[1]))
        code *= _STEPS
        code = np.clip(np.rint(code) + _ONE, 1, _UNKNOWN - 1).astype(np.uint8)
        code[~known] = _UNKNOWN
        return cls(
            np.packbits(pictures.lit, axis=1),
            np.clip(radiance, -_LARGEST, _LARGEST).astype(np.float16),
            code,
        )

    @property
    def channels(self) -> int:
        """Number of colour channels."""
        return int(self.radiance.shape[1])

    def unpacked(self, lit: Bools, unit: float) -> Pictures:
        """Return the pictures, of the patterns `lit` (P, N), with radiance times a unit."""
        scale = np.float32(unit)
        radiance = self.radiance.astype(np.float32) * scale
        return Pictures(lit, radiance, _VARIANCES[self.variance] * scale**2)

    def select(self, index: int) -> PackedPictures:
        """Select a picture; arrays are views."""
        one = slice(index, index + 1)
        return PackedPictures(self.lit[one], self.radiance[one], self.variance[one])


@dataclass(frozen=True)
class PackedView(ViewPictures):
    """Packed pictures of one projector view; radiance and variance are unpacked at each use.

    Attributes
    ----------
    pictures : sequence of PackedPictures
        The pictures of patterns on the view, one by one.
    channels : slice
        Channels that are added up.
    rays : slice
        Projector rays of the view.
    """

    pictures: Sequence[PackedPictures]
    channels: slice
    rays: slice

    @cached_property
    def patterns(self) -> Float:  # type: ignore[override]
        """p: weight of each projector pixel in each pattern, 0 or 1, (N, P)."""
        lit = np.concatenate([picture.lit for picture in self.pictures])
        lit = np.unpackbits(lit, axis=1, count=self.rays.stop)[:, self.rays]
        return np.ascontiguousarray(lit.T, np.float32)

    @property
    def radiance(self) -> Float:  # type: ignore[override]
        """c, 0 where a pixel is unknown, (M, P)."""
        return np.stack([self._radiance(it, slice(None)) for it in self.pictures], axis=1)

    @property
    def variance(self) -> Float:  # type: ignore[override]
        """Variance of c, infinite where a pixel is unknown, (M, P)."""
        return np.stack([self._variance(it, slice(None)) for it in self.pictures], axis=1)

    def first(self) -> tuple[Float, Float]:
        """Return radiance and variance of the floodlit picture, (M,) each."""
        pixels = slice(None)
        return self._radiance(self.pictures[0], pixels), self._variance(self.pictures[0], pixels)

    def at(self, camera_pixels: slice | Index | None) -> ViewArrays:
        """Select camera pixels by their numbers; None selects all."""
        pixels = slice(None) if camera_pixels is None else camera_pixels
        radiance, variance = (
            np.stack([unpack(picture, pixels) for picture in self.pictures], axis=1)
            for unpack in (self._radiance, self._variance)
        )
        return ViewArrays(self.patterns, radiance, variance)

    def _radiance(self, picture: PackedPictures, pixels: slice | Index) -> Float:
        """Return the radiance of a picture at some pixels, (m,)."""
        planes = picture.radiance[0, self.channels][:, pixels]
        total: Float = planes.sum(axis=0, dtype=np.float32)
        return total

    def _variance(self, picture: PackedPictures, pixels: slice | Index) -> Float:
        """Return the variance of a picture at some pixels, (m,)."""
        planes = _VARIANCES[picture.variance[0, self.channels][:, pixels]]
        total: Float = planes.sum(axis=0)
        return total


@dataclass(frozen=True)
class IndirectPictures:
    """Indirect light in the pictures of a projector view, computed where it is used.

    It is the product ``diag(f) L (S J)``, of which ``[rays]`` computes rows, (m, P).

    Attributes
    ----------
    L : csr_array of float32, shape (M, n)
    f : ndarray of float32, shape (M,)
    received : ndarray of float32, shape (n, P)
        S J.
    """

    L: csr_array[np.float32]
    f: Float
    received: Float

    def __getitem__(self, rays: slice | Index) -> Float:
        """Compute the light at camera rays, (m, P)."""
        images: Float = self.L[rays] @ self.received
        images *= self.f[rays, None]
        return images


def radiance_unit(floodlit: Pictures) -> float:
    """Compute the unit of radiance in the fit: the power of two nearest the mean floodlit image.

    A power of two changes no digit of a float.
    """
    light = np.abs(floodlit.floodlit[:, floodlit.known]).astype(np.float64)
    mean = float(light.mean()) if light.size else 0.0
    return float(2.0 ** np.round(np.log2(mean))) if mean > 0 else 1.0


def split_pictures(
    packed: Sequence[PackedPictures], channels: slice, projector: RayDomain
) -> tuple[ViewPictures, ...]:
    """Split the sum of some channels of pictures by projector view.

    With several views each pattern lights one of them; the first one on each view is floodlit.
    """
    views, size = projector.views, projector.rays_per_image
    of_view: list[list[PackedPictures]] = [[] for _ in range(views)]
    pictures = (part.select(index) for part in packed for index in range(len(part.lit)))
    for number, picture in enumerate(pictures):
        lit = np.unpackbits(picture.lit, count=projector.size).reshape(views, size)
        if views == 1 or number > 0:  # else it is the picture of all views
            view = int(lit.any(axis=1).argmax())
            is_first = not of_view[view]
            assert not is_first or lit[view].all(), f"the first of view {view} is not floodlit"
            of_view[view].append(picture)
    return tuple(
        PackedView(of_view[view], channels, slice(view * size, (view + 1) * size))
        for view in range(views)
    )


def floodlit_by_all(pictures: Sequence[ViewPictures]) -> Float:
    """Add up the floodlit images of all projector views: F, at least 0, (M,)."""
    return sum((view.floodlit for view in pictures[1:]), pictures[0].floodlit)
