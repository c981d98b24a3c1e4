"""Noise of a camera's counts according to its settings.

Variance of y counts above black in an exposure of t seconds:

    v = U ((s^2 + d t) / k^2 + 1/12 + y / k)

====== ============= ====== ====================================================================
symbol code          shape  meaning
====== ============= ====== ====================================================================
U      UNSURE        ()     factor on the variance
s      camera        ()     read noise in electrons
d      camera        ()     dark current in electrons per second
k      camera        ()     electrons per count; 1/12 is the variance of rounding
v(0)   fixed         (E,)   variance without light
U / k  per_count     ()     variance per count above black
====== ============= ====== ====================================================================
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rfpipe.array_types import Double
from rfpipe.photometry.camera import CameraModel

UNSURE = 4.0
"""Factor on the variance, since settings may not be measured yet: it covers a full well that is
four times smaller than in the settings."""


class CountNoise(NamedTuple):
    """Variance of counts.

    Attributes
    ----------
    fixed : ndarray of float64, shape (E,)
        Variance without light, in squared counts.
    per_count : float
        Variance per count above black.
    """

    fixed: Double
    per_count: float

    @classmethod
    def of(cls, camera: CameraModel) -> CountNoise:
        """Compute the noise of a camera's exposures."""
        electrons = camera.electrons_per_count
        glow = camera.dark_current_electrons * np.asarray(camera.exposures)
        fixed = (camera.read_noise_electrons**2 + glow) / electrons**2 + 1 / 12
        return cls(UNSURE * fixed, UNSURE / electrons)

    def variance(self, light: Double) -> Double:
        """Variance of counts above black, (E, n)."""
        return np.asarray(self.fixed[:, None] + self.per_count * np.maximum(light, 0))
