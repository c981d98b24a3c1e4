"""Pictures of the patterns on one projector view, pixel by pixel.

Footprints are recognised by the radiance of a camera pixel over all patterns. In these arrays each
row is a camera pixel and each column a picture; in `rfpipe.methods.images` each row is a picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.array_types import Bools, Float, Index
from rfpipe.methods.base import SIGNIFICANCE
from rfpipe.methods.images import Pictures

# Errors of any model, relative to the floodlit image of the pixel and to its mean over all pixels.
_MODEL_ERROR, _LEAST_ERROR = 0.002, 1e-5


@dataclass(frozen=True)
class ViewPictures:
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

    @property
    def floodlit(self) -> Float:
        """Floodlit image, at least 0, (M,)."""
        return np.maximum(self.radiance[:, 0], 0)

    @property
    def known(self) -> Bools:
        """Pixels with finite variance in all pictures, (M,)."""
        return np.asarray(np.isfinite(self.variance).all(axis=1))

    @property
    def lit_pixels(self) -> Bools:
        """Pixels whose floodlit radiance exceeds 3 standard deviations of noise, (M,)."""
        noise = np.sqrt(np.where(self.known, self.variance[:, 0], 0))
        return np.asarray(self.known & (self.radiance[:, 0] > SIGNIFICANCE * noise))

    def has_light(self) -> bool:
        """Return True if the sum of the floodlit image exceeds 3 standard deviations of noise."""
        known = self.known
        light = float(self.radiance[known, 0].sum(dtype=np.float64))
        noise = float(np.sqrt(self.variance[known, 0].sum(dtype=np.float64)))
        return light > SIGNIFICANCE * noise

    def at(self, camera_pixels: Index | None) -> ViewPictures:
        """Select camera pixels by their numbers; None selects all."""
        if camera_pixels is None:
            return self
        return ViewPictures(
            self.patterns, self.radiance[camera_pixels], self.variance[camera_pixels]
        )

    def inverse_variance(self, model_error: float = 0.0) -> Float:
        """Compute the inverse variance of the difference between picture and model, (M, P).

        It is 0 for masked pixels. The variance includes errors of the model: 0.2 % of the floodlit
        image, `model_error` of the floodlit image, and 1e-5 of its mean over all pixels.
        """
        floodlit = self.floodlit[:, None]
        least = _LEAST_ERROR * float(floodlit.mean(dtype=np.float64))
        model_variance = (_MODEL_ERROR**2 + model_error**2) * np.square(floodlit) + least**2
        precision: Float = (1 / (self.variance + model_variance)).astype(np.float32)
        return precision

    def relative_noise(self) -> float:
        """Compute the median over pixels of the variance of a picture over squared floodlit light.

        It is 1 if no pixel is lit.
        """
        lit = self.lit_pixels
        if not lit.any():
            return 1.0
        has_patterns = self.patterns.shape[1] > 1
        variance = self.variance[lit, 1:].mean(axis=1) if has_patterns else self.variance[lit, 0]
        return float(np.median(variance / np.square(self.floodlit[lit])))


def radiance_unit(pictures: Pictures) -> float:
    """Compute the unit of radiance in the fit: the power of two nearest the mean floodlit image.

    A power of two changes no digit of a float.
    """
    light = np.abs(pictures.floodlit[:, pictures.known]).astype(np.float64)
    mean = float(light.mean()) if light.size else 0.0
    return float(2.0 ** np.round(np.log2(mean))) if mean > 0 else 1.0


def split_pictures(pictures: Pictures, unit: float, views: int) -> tuple[ViewPictures, ...]:
    """Split the pictures of one channel by projector view, in units of radiance.

    With several views each pattern lights one of them; the first one on each view is floodlit.
    """
    known = np.isfinite(pictures.variance[:, 0]).all(axis=0)
    if views > 1:
        pictures = pictures.probes
    parts = []
    for view, patterns in enumerate(np.split(pictures.lit, views, axis=1)):
        on_view = patterns.any(axis=1)
        radiance, variance = pictures.radiance[on_view, 0], pictures.variance[on_view, 0]
        assert patterns[on_view][0].all(), f"the first pattern on view {view} is not floodlit"
        parts.append(
            ViewPictures(
                np.ascontiguousarray(patterns[on_view].T, np.float32),
                np.ascontiguousarray(np.where(known, radiance / unit, 0).T, np.float32),
                np.ascontiguousarray(np.where(known, variance / unit / unit, np.inf).T, np.float32),
            )
        )
    return tuple(parts)


def floodlit_by_all(pictures: tuple[ViewPictures, ...]) -> Float:
    """Add up the floodlit images of all projector views: F, at least 0, (M,)."""
    return sum((view.floodlit for view in pictures[1:]), pictures[0].floodlit)
