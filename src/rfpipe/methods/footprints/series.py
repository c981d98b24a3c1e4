"""What the camera's pixels show over time: the pictures as footprint acquisition looks at them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.footprints.typed import Float, Int64

__all__ = ["Series"]

# What a model is taken to be wrong by in any case, as a fraction of the floodlit image; and what no
# pixel is known better than, as a fraction of the mean floodlit image.
_WRONG, _DARK = 0.002, 1e-5
# What exceeds noise by so many standard deviations is light.
_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class Series:
    """Pictures of one channel, or of the sum of channels, pixel by pixel; the first is floodlit.

    Attributes
    ----------
    lit : ndarray of float32, shape (N, M)
        The patterns, 0 or 1, of the N pixels of the projector, or of one of its views.
    seen : ndarray of float32, shape (pixels, M)
        Radiance; 0 where a pixel is unknown.
    variance : ndarray of float32, shape (pixels, M)
        Infinite where a pixel is unknown, which is then evidence of nothing.
    """

    lit: Float
    seen: Float
    variance: Float

    @property
    def floodlit(self) -> Float:
        """What pixels show under full light, at least 0, (pixels,)."""
        return np.maximum(self.seen[:, 0], 0)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels that the pictures show, (pixels,)."""
        return np.asarray(np.isfinite(self.variance).all(axis=1))

    @property
    def shining(self) -> NDArray[np.bool_]:
        """Pixels whose floodlit radiance is more than noise, (pixels,)."""
        noise = np.sqrt(np.where(self.known, self.variance[:, 0], 0))
        return np.asarray(self.known & (self.seen[:, 0] > _SIGNIFICANT * noise))

    def shines(self) -> bool:
        """Tell whether the floodlit image as a whole is brighter than its noise."""
        known = self.known
        light = float(self.seen[known, 0].sum(dtype=np.float64))
        noise = float(np.sqrt(self.variance[known, 0].sum(dtype=np.float64)))
        return light > _SIGNIFICANT * noise

    def of(self, chosen: Int64) -> Series:
        """Return what some of the camera's pixels show."""
        return Series(self.lit, self.seen[chosen], self.variance[chosen])

    def certainty(self, wrong: float = 0.0) -> Float:
        """Return inverse variances, (pixels, M); 0 of unknown pixels.

        Parameters
        ----------
        wrong : float
            What else may be wrong on a pixel, as a fraction of the floodlit image.
        """
        floodlit = self.floodlit[:, None]
        least = _DARK * float(floodlit.mean(dtype=np.float64))
        spread = (_WRONG**2 + wrong**2) * np.square(floodlit) + least**2
        found: Float = (1 / (self.variance + spread)).astype(np.float32)
        return found

    def relative_noise(self) -> float:
        """Return the typical variance of a picture relative to its pixel's floodlit radiance."""
        own = self.shining
        if not own.any():
            return 1.0
        share = (
            self.variance[own, 1:].mean(axis=1) if self.lit.shape[1] > 1 else self.variance[own, 0]
        )
        return float(np.median(share / np.square(self.floodlit[own])))
