"""Pictures as the near/far model is fitted to them: sums over cells of lit and of dark pixels.

The functions of the near/far model are constant over cells of pixels. All that a fit needs of a
picture are the sums over the pixels of each cell that its pattern lights, and over those that it
leaves dark. They are computed once, as pictures are read. Images of up to `MOST_PIXELS` pixels have
cells of a single pixel.

========  =====================  ============  ====================================================
symbol    name in the code       shape         meaning and unit
========  =====================  ============  ====================================================
``p``                            (P, N)        patterns, 0 or 1
``c``                            (P, C, N)     pictures, radiance
``F``     `floodlit`             (C, N)        floodlit image, radiance
``F p``   `light`                (P, C, M')    floodlit image of lit pixels
          `dark`                 (P, C, M')    pictures on dark pixels
          `excess`               (P, C, M')    pictures minus floodlit image, on lit pixels
          `dark_variance`,       (P, C, M')    variances of `dark` and of `excess`; 0 where a cell
          `lit_variance`                       has no such pixel
========  =====================  ============  ====================================================

All are sums over the pixels of each of M' cells; except for `light`, over known pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Bools, Float
from rfpipe.blocks import RayDomain
from rfpipe.methods.images import Pictures
from rfpipe.transport.wavelet import Cells, cell_side

MOST_PIXELS = 2**17
"""Largest number of pixels that are cells of their own. A fit to 30 RGB pictures then takes about
1 GB. With cells of 2 x 2 pixels, errors of wedge IV at 310 x 350 are 7 % larger."""

MOST_CELLS = 2**15
"""Largest number of cells of larger images. On wedge IV at 768 x 1,024, 5 x 5 pixels leave 10 %
less error than 3 x 3, since fits end after a fixed number of iterations."""


@lru_cache(maxsize=2)
def fit_cells(shape: tuple[int, ...]) -> Cells:
    """Divide a ray domain into single pixels, or the smallest cells within the limits above."""
    is_small = RayDomain(shape).size <= MOST_PIXELS
    return Cells(shape, 1 if is_small else cell_side(shape, MOST_CELLS))


@dataclass(frozen=True)
class SplitPictures:
    """Sums of P pictures over the lit and over the dark pixels of cells; see the module.

    Attributes
    ----------
    light, dark, excess, dark_variance, lit_variance : ndarray of float32, shape (P, C, M')
    dark_count : ndarray of int64, shape (P,)
        Number of known dark pixels.
    """

    light: Float
    dark: Float
    excess: Float
    dark_variance: Float
    lit_variance: Float
    dark_count: NDArray[np.int64]

    @classmethod
    def of(cls, cells: Cells, floodlit: Pictures, pictures: Pictures) -> SplitPictures:
        """Sum up pictures, one by one to save memory.

        Parameters
        ----------
        cells : Cells
        floodlit : Pictures
            The floodlit picture alone; pixels that are unknown in it count as unknown.
        pictures : Pictures
        """
        count, known = len(pictures.lit), floodlit.known
        shape = (count, pictures.channels, cells.count)
        light, dark, excess, dark_variance, lit_variance = np.empty((5, *shape), np.float32)
        floodlit_variance = np.where(known, floodlit.variance[0], 0)
        for index, lit in enumerate(pictures.lit):
            is_lit, is_dark = lit & known, ~lit & known
            radiance, variance = pictures.radiance[index], pictures.variance[index]
            for total, image in (
                (light, floodlit.floodlit * lit),
                (dark, np.where(is_dark, radiance, 0)),
                (excess, np.where(is_lit, radiance - floodlit.floodlit, 0)),
                (dark_variance, np.where(is_dark, variance, 0)),
                (lit_variance, np.where(is_lit, variance + floodlit_variance, 0)),
            ):
                total[index] = cells.total(image).T
        dark_count = np.count_nonzero(~pictures.lit & known, axis=1)
        return cls(light, dark, excess, dark_variance, lit_variance, dark_count)

    def of_pixels(self, floodlit: Pictures, lit: Bools) -> Pictures:
        """Return the pictures of the patterns `lit` (P, N); each cell must be a single pixel."""
        is_lit, known, noise = lit[:, None], floodlit.known, floodlit.variance[0]
        radiance = np.where(is_lit, self.excess + floodlit.floodlit, self.dark)
        # the rounding of the sum of both variances can exceed a small one
        of_lit = np.maximum(self.lit_variance - noise, TINY)
        variance = np.where(is_lit, of_lit, self.dark_variance)
        return Pictures(
            lit,
            np.where(known, radiance, np.float32(0)),
            np.where(known, variance, np.float32(np.inf)),
        )

    @property
    def channels(self) -> int:
        """Number of colour channels."""
        return int(self.light.shape[1])

    @property
    def probes(self) -> SplitPictures:
        """All pictures except the first, which is floodlit."""
        return SplitPictures(*(getattr(self, entry.name)[1:] for entry in fields(self)))

    def channel(self, index: int) -> SplitPictures:
        """Select a channel."""
        return self._of_channels(lambda sums: sums[:, index : index + 1])

    def grey(self) -> SplitPictures:
        """Add up the channels."""
        return self._of_channels(lambda sums: sums.sum(axis=1, keepdims=True))

    def _of_channels(self, select: Callable[[Float], Float]) -> SplitPictures:
        sums = {
            entry.name: select(getattr(self, entry.name))
            for entry in fields(self)
            if entry.name != "dark_count"
        }
        return SplitPictures(**sums, dark_count=self.dark_count)
