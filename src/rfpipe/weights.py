"""What counts as a pattern's weights: 1 is fully on, whatever a picture's largest number is."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError

__all__ = ["Curve", "as_weights", "curve_slope", "picture_weights"]

Curve = Literal["linear", "srgb"]
"""How a picture's numbers tell light: in proportion, or by the transfer curve of sRGB."""


def as_weights(weights: ArrayLike, name: str = "the pattern") -> NDArray[Any]:
    """Return an array whose numbers mean weights, or refuse it.

    Floating-point numbers are weights as they stand. Of whole numbers only 0, 1 and -1 are: in
    others nobody can tell weights from a picture's counts, 0 to 255 or 0 to 65,535.

    Parameters
    ----------
    weights : array_like
    name : str
        What an error calls it.

    Returns
    -------
    ndarray
        Of floating-point numbers; those given where they were.

    Raises
    ------
    InputError
        When it holds whole numbers beyond -1 and 1, or no real numbers at all.
    """
    weights = np.asarray(weights)
    if weights.dtype.kind == "f":
        return weights
    if weights.dtype.kind not in "biu":
        raise InputError(f"{name} holds {weights.dtype} values; expected weights, real numbers")
    if weights.dtype.kind != "b" and weights.size:
        least, largest = int(weights.min()), int(weights.max())
        if least < -1 or largest > 1:
            raise InputError(
                f"{name} is {weights.dtype} with values from {least} to {largest}, and weights are "
                "fractions, 1 for fully on; give rfpipe.picture_weights(picture) for a picture, "
                "which divides by its largest number, or picture.astype(float) if weights of "
                f"{largest} are meant"
            )
    return weights.astype(np.float32)


def picture_weights(picture: ArrayLike, curve: Curve = "linear") -> NDArray[np.float32]:
    """Return the weights that the numbers of a picture stand for.

    Parameters
    ----------
    picture : array_like
        Whole numbers are divided by the largest of their kind, 255 of uint8 or 65,535 of uint16;
        floating-point numbers are taken as fractions of 1 already.
    curve : {"linear", "srgb"}
        Whether the numbers are light, or light as a screen's picture codes it (IEC 61966-2-1).

    Returns
    -------
    ndarray of float32, the picture's shape
        In [0, 1].

    Raises
    ------
    InputError
        When a number is negative, NaN or above 1, or the dtype is one of signed whole numbers,
        whose largest no picture reaches.
    """
    if curve not in get_args(Curve):
        raise InputError(f"curve is {curve!r}; expected one of {', '.join(get_args(Curve))}")
    picture = np.asarray(picture)
    if picture.dtype.kind not in "fub":
        raise InputError(
            f"a picture of {picture.dtype} values, whose white nobody can tell; convert it to "
            "uint8 or uint16, or divide it by its white"
        )
    white = float(np.iinfo(picture.dtype).max) if picture.dtype.kind == "u" else 1.0
    weights = picture / white
    if not ((weights >= 0) & (weights <= 1)).all():  # NaN is neither
        raise InputError(
            f"a picture of {picture.dtype} values from {picture.min()} to {picture.max()}; "
            "fractions lie between 0 and 1: divide it by its white"
        )
    if curve == "srgb":
        low = weights <= 0.04045
        weights = np.where(low, weights / 12.92, ((weights + 0.055) / 1.055) ** 2.4)
    return weights.astype(np.float32)


def curve_slope(light: NDArray[np.floating], curve: Curve) -> NDArray[np.floating]:
    """Return the change of linear light per change of a picture's number, of the light's shape.

    Both count from 0 to 1; `light` is linear.
    """
    if curve == "linear":
        return np.ones_like(light)
    steep = 2.4 / 1.055 * np.maximum(light, 0) ** (1 - 1 / 2.4)
    return np.where(light <= 0.0031308, 1 / 12.92, steep)
