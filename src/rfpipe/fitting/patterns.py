"""Patterns of one size, read one at a time, and the linear light of a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.pictures.files import Part, Picture, read_parts
from rfpipe.weights import Curve, as_weights, picture_weights

_FULL_SCALES = (255, 1023, 4095, 16383, 65535)


@dataclass(frozen=True)
class Patterns:
    """Patterns of one size, read one at a time.

    Attributes
    ----------
    shape : (int, int)
        Height and width in projector pixels.
    readers : sequence of callable
        Each returns one pattern: weights, at least 0, shape (H, W) or (H, W, 3).
    largest : float
        Largest weight in an array; pictures and single lights have at most 1.
    """

    shape: tuple[int, int]
    readers: Sequence[Callable[[], NDArray[Any]]] = field(repr=False)
    largest: float = 1.0

    def __len__(self) -> int:
        """Return the number of patterns."""
        return len(self.readers)

    @classmethod
    def of_array(cls, weights: NDArray[Any], name: str) -> Patterns:
        """Take patterns from an array (K, H, W) or (K, H, W, 3) of weights, 1 for fully on.

        Raises InputError for another shape, for weights that are negative or not finite, and for
        counts of a picture, such as 0 to 255.
        """
        if weights.ndim not in (3, 4) or (weights.ndim == 4 and weights.shape[3] not in (1, 3)):
            raise InputError(
                f"{name}: an array {weights.shape}; expected (pictures, H, W) or "
                "(pictures, H, W, 3)"
            )
        weights = as_weights(weights, name)
        if not (np.isfinite(weights).all() and (weights >= 0).all()):
            raise InputError(
                f"{name}: patterns should be finite and not negative, every weight; 1 is fully on"
            )
        largest = float(weights.max(initial=0))
        if largest in _FULL_SCALES and (weights == np.rint(weights)).all():
            raise InputError(
                f"{name}: has whole numbers up to {largest:g}, the counts of a picture; weights "
                f"are fractions, 1 for fully on: divide them by {largest:g}"
            )
        readers = [partial(weights.__getitem__, k) for k in range(len(weights))]
        return cls(weights.shape[1:3], readers, largest)

    @classmethod
    def of_files(cls, files: Sequence[Path], curve: Curve) -> Patterns:
        """Take patterns from picture files of one size; InputError where sizes differ."""
        parts = [part for file in files for part in read_parts(file)]
        for part in parts:
            if part.header.size != parts[0].header.size:
                raise InputError(f"{part} has another size than {parts[0]}; patterns have one")
        return cls(parts[0].header.size, [partial(linear_light, part, curve) for part in parts])

    @classmethod
    def single_lights(cls, rows: int, columns: int) -> Patterns:
        """Take one light at a time, of lights in rows and columns."""

        def light(index: int) -> Float:
            lit = np.zeros(rows * columns, np.float32)
            lit[index] = 1
            return lit.reshape(rows, columns)

        return cls((rows, columns), [partial(light, index) for index in range(rows * columns)])


def linear_light(part: Part, curve: Curve) -> Float:
    """Read a picture as linear light, float32 (H, W, C); integers go from 0 to 1."""
    return light_of(part.read(), curve, str(part))


def light_of(picture: Picture, curve: Curve, name: str) -> Float:
    """Return a picture as linear light, float32 (H, W, C); integers go from 0 to 1."""
    if picture.header.kind == "counts":
        return picture_weights(picture.fractions, curve)
    if not np.isfinite(picture.pixels).all():
        raise InputError(f"{name}: holds NaN or infinite light; every value should be finite")
    return picture.fractions
