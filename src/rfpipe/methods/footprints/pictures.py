"""Pictures of the patterns on one projector view, pixel by pixel.

Footprints are recognised by the radiance of a camera pixel over all patterns. In these arrays each
row is a camera pixel and each column a picture; in `rfpipe.methods.images` each row is a picture.

A fit of a light field goes through all pictures many times, view by view. They are stored in a
packed form of 3 bytes a value, radiance as float16 and the logarithm of the variance in 8 bits, in
temporary files, and are read and unpacked for one view at a time. The rounding of the radiance,
0.02 %, is a tenth of the error that any fit assumes of its model; that of the variance is 6 %.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.base import SIGNIFICANCE
from rfpipe.methods.images import Pictures
from rfpipe.ranges import ranges
from rfpipe.store.scratch import ScratchArray

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
    """Packed pictures of on-off patterns, of all channels; arrays may be in temporary files.

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
    radiance: NDArray[np.float16] | ScratchArray
    variance: NDArray[np.uint8] | ScratchArray

    @classmethod
    def stored(cls, parts: Iterable[PackedPictures]) -> PackedPictures:
        """Join pictures, with radiance and variance in temporary files; one part is in memory."""
        lit: list[NDArray[np.uint8]] = []
        for part in parts:
            if not lit:
                radiance, variance = (
                    ScratchArray(array.dtype, array.shape[1:])
                    for array in (part.radiance, part.variance)
                )
            lit.append(part.lit)
            radiance.append(part.radiance[:])
            variance.append(part.variance[:])
        return cls(np.concatenate(lit), radiance, variance)

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
        radiance = self.radiance[:].astype(np.float32) * scale
        return Pictures(lit, radiance, _VARIANCES[self.variance[:]] * scale**2)


class PackedPicture(NamedTuple):
    """A picture of `packed` ones, by its number."""

    packed: PackedPictures
    number: int

    def radiance(self, channels: slice, pixels: slice | Index) -> Float:
        """Return the sum of channels at some camera pixels, (m,)."""
        planes = self.packed.radiance[self.number : self.number + 1, channels, pixels]
        total: Float = planes[0].sum(axis=0, dtype=np.float32)
        return total

    def variance(self, channels: slice, pixels: slice | Index) -> Float:
        """Return the variance of the sum of channels at some camera pixels, (m,)."""
        codes = self.packed.variance[self.number : self.number + 1, channels, pixels]
        total: Float = _VARIANCES[codes[0]].sum(axis=0)
        return total


@dataclass(frozen=True)
class PackedView(ViewPictures):
    """Packed pictures of one projector view; radiance and variance are unpacked at each use.

    Attributes
    ----------
    pictures : sequence of PackedPicture
        The pictures of patterns on the view.
    channels : slice
        Channels that are added up.
    rays : slice
        Projector rays of the view.
    """

    pictures: Sequence[PackedPicture]
    channels: slice
    rays: slice

    @cached_property
    def patterns(self) -> Float:  # type: ignore[override]
        """p: weight of each projector pixel in each pattern, 0 or 1, (N, P)."""
        lit = np.stack([packed.lit[number] for packed, number in self.pictures])
        lit = np.unpackbits(lit, axis=1, count=self.rays.stop)[:, self.rays]
        return np.ascontiguousarray(lit.T, np.float32)

    @property
    def radiance(self) -> Float:  # type: ignore[override]
        """c, 0 where a pixel is unknown, (M, P)."""
        return self.at(None).radiance

    @property
    def variance(self) -> Float:  # type: ignore[override]
        """Variance of c, infinite where a pixel is unknown, (M, P)."""
        return self.at(None).variance

    def first(self) -> tuple[Float, Float]:
        """Return radiance and variance of the floodlit picture, (M,) each."""
        channels, pixels = self.channels, slice(None)
        picture = self.pictures[0]
        return picture.radiance(channels, pixels), picture.variance(channels, pixels)

    def at(self, camera_pixels: slice | Index | None) -> ViewArrays:
        """Select camera pixels by their numbers; None selects all."""
        pixels = slice(None) if camera_pixels is None else camera_pixels
        radiance = [picture.radiance(self.channels, pixels) for picture in self.pictures]
        variance = [picture.variance(self.channels, pixels) for picture in self.pictures]
        return ViewArrays(self.patterns, np.stack(radiance, axis=1), np.stack(variance, axis=1))


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
    of_view: list[list[PackedPicture]] = [[] for _ in range(views)]
    pictures = (PackedPicture(part, index) for part in packed for index in range(len(part.lit)))
    for number, picture in enumerate(pictures):
        bits = picture.packed.lit[picture.number]
        lit = np.unpackbits(bits, count=projector.size).reshape(views, size)
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
