"""Sizes of what is exported, relative to a transport's rays."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.rays import squares

Float = NDArray[np.float32]

_TEXT = re.compile(r"(?:(\d+)|1/(\d+))")


@dataclass(frozen=True)
class Scale:
    """How many pixels a ray becomes along a side, or how many rays a pixel.

    Attributes
    ----------
    enlarge : int
        Each pixel is repeated so often, down and across.
    reduce : int
        So many rays down and across become their mean; one of both is 1.
    """

    enlarge: int = 1
    reduce: int = 1

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``"4"``, four times as large, or ``"1/4"``, a fourth.

        Raises
        ------
        InputError
            If it is neither.
        """
        found = _TEXT.fullmatch(text.strip())
        enlarge, reduce = (int(part or 1) for part in found.groups()) if found else (0, 0)
        if not enlarge or not reduce:
            raise InputError(
                f"scale {text!r}: expected a whole number, as 4, or one over a whole number, as 1/4"
            )
        return cls(enlarge, reduce)

    def apply(self, image: Float) -> Float:
        """Return an image ``(H, W, C)`` at this size; the last means may be of fewer rays."""
        if self.reduce > 1:
            grid, sums = squares(image.shape[:2], self.reduce)
            means = sums @ image.reshape(-1, image.shape[-1]) / sums.sum(axis=1)[:, None]
            image = means.reshape(*grid, -1).astype(np.float32)
        return image.repeat(self.enlarge, axis=0).repeat(self.enlarge, axis=1)
