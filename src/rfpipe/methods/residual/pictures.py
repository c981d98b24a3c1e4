"""Pictures of cells: all that an estimate of what a model leaves has to know of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.transport.wavelet.cells import Cells

__all__ = ["Canvas", "CellPictures"]

# Part of its mean that is added to the floodlit image: dim pixels may exchange light, too.
_LIFTED = 0.02
# F is this power of it: half of what a surface returns goes with the light that it gets, half with
# the light that it sends.
_EXPONENT = 0.5


@dataclass(frozen=True)
class CellPictures:
    """Pictures, summed over cells.

    Attributes
    ----------
    lit : ndarray of bool, shape (M, N)
        The patterns, in pixels.
    seen, variance : ndarray of float32, shape (M, C, cells)
        See `Canvas.reduced`.
    """

    lit: NDArray[np.bool_]
    seen: Float
    variance: Float


class Canvas:
    """What all pictures of an acquisition share.

    Parameters
    ----------
    cells : Cells
    floodlit : ndarray of float32, shape (C, N)
    known : ndarray of bool, shape (N,)
        Pixels that the pictures show.
    """

    def __init__(self, cells: Cells, floodlit: Float, known: NDArray[np.bool_]) -> None:
        self.cells, self.known = cells, known
        light = np.maximum(floodlit, 0)
        self.brightest: Float = light.max(axis=1)
        lifted = light + np.float32(_LIFTED) * light.mean(axis=1, keepdims=True)
        root = np.power(lifted, np.float32(_EXPONENT))
        mean = root.mean(axis=1, keepdims=True)
        self.factor: Float = np.divide(root, mean, out=np.zeros_like(root), where=mean > 0)
        """F, float32 (C, N), of mean 1."""

    @cached_property
    def weight(self) -> Float:
        """Sums of F^2 over the known pixels of each cell, (C, cells)."""
        return np.ascontiguousarray(self.cells.total(self.factor**2 * self.known).T)

    def reduced(self, images: Float) -> Float:
        """Return the least-squares fit of F times a constant in each cell to images (M, C, N).

        Returns
        -------
        ndarray of float32, shape (M, C, cells)
            0 where a cell has no known pixel.
        """
        planes = [self.reduced_channel(images[:, c], c) for c in range(images.shape[1])]
        return np.stack(planes, axis=1)

    def reduced_channel(self, images: Float, channel: int) -> Float:
        """Return `reduced` of one channel's images (M, N), (M, cells)."""
        return self._over(self.weight[channel], images, self.factor[channel] * self.known)

    def spread(self, variance: Float) -> Float:
        """Return the variance of `reduced`, of images' variances (M, C, N); infinite if unknown."""
        known = np.where(self.known, variance, 0)
        planes = [
            self._over(weight**2, known[:, c], np.square(self.factor[c]))
            for c, weight in enumerate(self.weight)
        ]
        return np.where(self.weight > 0, np.stack(planes, axis=1), np.float32(np.inf))

    def _over(self, weight: Float, images: Float, factor: Float) -> Float:
        sums = self.cells.total(images * factor).T
        return np.divide(sums, weight, out=np.zeros(sums.shape, np.float32), where=weight > 0)

    def taken(self, lit: NDArray[np.bool_], radiance: Float, variance: Float) -> CellPictures:
        """Return pictures (M, C, N) of patterns (M, N), summed over cells."""
        return CellPictures(lit, self.reduced(radiance), self.spread(variance))
