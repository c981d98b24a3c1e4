"""The pictures that models of light are fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float, LevelImages
from rfpipe.methods.images import read_planar

SIGNIFICANT = 3.0
"""What exceeds noise by so many standard deviations is light."""


@dataclass(frozen=True)
class Pictures:
    """Pictures of patterns of light and dark; the first of an acquisition is floodlit.

    Attributes
    ----------
    lit : ndarray of bool, shape (P, N)
        The patterns.
    radiance, variance : ndarray of float32, shape (P, C, M)
        The variance is infinite where a pixel is unknown: no fit, test or estimate looks at it.
    """

    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float

    @classmethod
    def read(
        cls, images: LevelImages, channels: int, pixels: int, first: int, last: int
    ) -> Pictures:
        """Read some of a level's images."""
        lit = images.schedule.batch(first, last) > 0
        planes = read_planar(images, channels, pixels, first, last)
        return cls(lit.reshape(len(lit), -1), *planes)

    def some(self, chosen: slice | NDArray[np.bool_]) -> Pictures:
        """Return some of the pictures."""
        return Pictures(self.lit[chosen], self.radiance[chosen], self.variance[chosen])

    @property
    def probes(self) -> Pictures:
        """All pictures but the floodlit one."""
        return self.some(slice(1, None))

    @property
    def floodlit(self) -> Float:
        """The floodlit image, (C, M)."""
        return np.asarray(self.radiance[0])

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.radiance.shape[1])

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels that the pictures show, (M,)."""
        return np.asarray(np.isfinite(self.variance[0]).all(axis=0))

    def shine(self) -> bool:
        """Tell whether the floodlit image as a whole is brighter than its noise."""
        known = self.known
        light = float(self.radiance[0][:, known].sum(dtype=np.float64))
        noise = float(np.sqrt(self.variance[0][:, known].sum(dtype=np.float64)))
        return light > SIGNIFICANT * noise

    def channel(self, index: int) -> Pictures:
        """Return one channel."""
        own = slice(index, index + 1)
        return Pictures(self.lit, self.radiance[:, own], self.variance[:, own])

    def grey(self) -> Pictures:
        """Return the sum of the channels as one."""
        return Pictures(
            self.lit,
            self.radiance.sum(axis=1, keepdims=True),
            self.variance.sum(axis=1, keepdims=True),
        )

    def completed(self, shape: tuple[int, ...]) -> Pictures:
        """Return pictures whose unknown pixels are as bright as the nearest known one's.

        Models take from the floodlit image how much light a ray sends; a pixel that nobody sees
        still lights others.
        """
        from scipy.ndimage import distance_transform_edt

        unknown = np.isinf(self.variance).any(axis=(0, 1))
        if not unknown.any():
            return self
        nearest = distance_transform_edt(
            unknown.reshape(shape), return_distances=False, return_indices=True
        )
        pixel = np.ravel_multi_index(tuple(nearest), shape).ravel()
        return Pictures(self.lit, self.radiance[..., pixel], self.variance)
