"""Sum of merged images and of their variance, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.array_types import Double
from rfpipe.photometry.sensor import MergedImages


@dataclass(eq=False)
class ImageSum:
    """Sum of images and of their variance.

    Attributes
    ----------
    radiance, variance : ndarray of float64, shape (*camera_shape, C)
    count : int
        Number of images.
    saturated : int
        Number of their samples that are saturated in every exposure.
    """

    radiance: Double
    variance: Double
    count: int = 0
    saturated: int = 0

    @classmethod
    def zero(cls, image_shape: tuple[int, ...]) -> ImageSum:
        """Return the sum of no images."""
        return cls(np.zeros(image_shape), np.zeros(image_shape))

    def add_images(self, merged: MergedImages) -> None:
        """Add images in their order, one by one, so that the result has reproducible bits."""
        for radiance, variance in zip(merged.radiance, merged.variance, strict=True):
            self.radiance += radiance
            self.variance += variance
            self.count += 1
        self.saturated += merged.saturated

    def add_sum(self, later: ImageSum) -> None:
        """Add the sum of later images."""
        self.radiance += later.radiance
        self.variance += later.variance
        self.count += later.count
        self.saturated += later.saturated
