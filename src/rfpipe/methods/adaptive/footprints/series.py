"""The pictures as footprint acquisition looks at them: what each camera pixel shows over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.images import SIGNIFICANT, Pictures

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


def distinct(keys: Int64) -> Int64:
    """Return the distinct keys, ascending; fast where they come in ascending runs."""
    ordered = np.sort(keys, kind="stable")  # merges runs
    is_new = np.ones(len(ordered), np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=is_new[1:])
    return ordered[is_new]


@dataclass(frozen=True)
class Series:
    """Pictures of one channel, or of the sum of channels, pixel by pixel; the first is floodlit.

    Attributes
    ----------
    lit : ndarray of float32, shape (N, P)
        The patterns, 0 or 1, of the N pixels of the projector, or of one of its views.
    observed : ndarray of float32, shape (pixels, P)
        Radiance; 0 where a pixel is unknown.
    variance : ndarray of float32, shape (pixels, P)
        Infinite where a pixel is unknown, which is then evidence of nothing.
    """

    lit: Float
    observed: Float
    variance: Float

    @property
    def floodlit(self) -> Float:
        """Radiance under full light, at least 0, (pixels,)."""
        return np.maximum(self.observed[:, 0], 0)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels that the pictures show, (pixels,)."""
        return np.asarray(np.isfinite(self.variance).all(axis=1))

    @property
    def shining(self) -> NDArray[np.bool_]:
        """Pixels whose floodlit radiance is more than noise, (pixels,)."""
        noise = np.sqrt(np.where(self.known, self.variance[:, 0], 0))
        return np.asarray(self.known & (self.observed[:, 0] > SIGNIFICANT * noise))

    def shines(self) -> bool:
        """Tell whether the floodlit image as a whole is brighter than its noise."""
        known = self.known
        light = float(self.observed[known, 0].sum(dtype=np.float64))
        noise = float(np.sqrt(self.variance[known, 0].sum(dtype=np.float64)))
        return light > SIGNIFICANT * noise

    def of(self, chosen: Int64 | None) -> Series:
        """Return the series of some of the camera's pixels; None for all."""
        if chosen is None:
            return self
        return Series(self.lit, self.observed[chosen], self.variance[chosen])

    def certainty(self, wrong: float = 0.0) -> Float:
        """Return inverse variances, (pixels, P); 0 of unknown pixels.

        A model is taken to be wrong by .002 of the floodlit image in any case, and `wrong` besides;
        no pixel is known better than 1e-5 of the mean floodlit image.
        """
        floodlit = self.floodlit[:, None]
        least = 1e-5 * float(floodlit.mean(dtype=np.float64))
        spread = (0.002**2 + wrong**2) * np.square(floodlit) + least**2
        precision: Float = (1 / (self.variance + spread)).astype(np.float32)
        return precision

    def relative_noise(self) -> float:
        """Return the typical variance of a picture relative to its pixel's floodlit radiance."""
        lit = self.shining
        if not lit.any():
            return 1.0
        share = (
            self.variance[lit, 1:].mean(axis=1) if self.lit.shape[1] > 1 else self.variance[lit, 0]
        )
        return float(np.median(share / np.square(self.floodlit[lit])))


def unit_of(pictures: Pictures) -> float:
    """Return the radiance about that of the floodlit image, a power of two: no digit is lost."""
    light = np.abs(pictures.floodlit[:, pictures.known]).astype(np.float64)
    mean = float(light.mean()) if light.size else 0.0
    return float(2.0 ** np.round(np.log2(mean))) if mean > 0 else 1.0


def series_of(pictures: Pictures, unit: float, views: int) -> tuple[Series, ...]:
    """Return one channel's pictures pixel by pixel in a unit, for each view of the projector.

    Patterns of several views light one of them at a time, all of it at first.
    """
    known = np.isfinite(pictures.variance[:, 0]).all(axis=0)
    if views > 1:
        pictures = pictures.probes
    series = []
    for view, lit in enumerate(np.split(pictures.lit, views, axis=1)):
        pattern = lit.any(axis=1)
        observed, variance = pictures.radiance[pattern, 0], pictures.variance[pattern, 0]
        assert lit[pattern][0].all(), f"view {view} was not lit whole at first"
        series.append(
            Series(
                np.ascontiguousarray(lit[pattern].T, np.float32),
                np.ascontiguousarray(np.where(known, observed / unit, 0).T, np.float32),
                np.ascontiguousarray(np.where(known, variance / unit / unit, np.inf).T, np.float32),
            )
        )
    return tuple(series)
