"""Weights of patterns, fractions of full light, and their conversion from pictures."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError

__all__ = ["Curve", "as_weights", "curve_slope", "picture_weights"]

Curve = Literal["linear", "srgb"]
"""Relation of a picture's numbers to light: proportional, or the transfer curve of sRGB."""


def as_weights(weights: ArrayLike, name: str = "the pattern") -> NDArray[Any]:
    """Validate an array of weights.

    Floating-point numbers are weights. Of integers only 0, 1 and -1 are accepted, since others may
    be counts of a picture, 0 to 255 or 0 to 65,535.

    Parameters
    ----------
    weights : array_like
    name : str
        Name of the array in errors.

    Returns
    -------
    ndarray
        Of floating-point numbers; `weights` itself if they are.

    Raises
    ------
    InputError
        If it has integers beyond -1 and 1, or values that aren't real numbers.
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
                f"{name} is {weights.dtype} with values from {least} to {largest}; weights are "
                "fractions, 1 for fully on. Give rfpipe.picture_weights(picture) for a picture, "
                "which divides by its largest number, or picture.astype(float) if weights of "
                f"{largest} are meant"
            )
    return weights.astype(np.float32)


def picture_weights(picture: ArrayLike, curve: Curve = "linear") -> NDArray[np.float32]:
    """Convert a picture to weights.

    Parameters
    ----------
    picture : array_like
        Integers are divided by the largest of their type, 255 of uint8 or 65,535 of uint16;
        floating-point numbers are fractions of 1.
    curve : {"linear", "srgb"}
        Whether the numbers are proportional to light, or coded for a screen (IEC 61966-2-1).

    Returns
    -------
    ndarray of float32, the picture's shape
        In [0, 1].

    Raises
    ------
    InputError
        If a number is negative, NaN or above 1, or the type is a signed integer, whose largest
        number is not white.
    """
    if curve not in get_args(Curve):
        raise InputError(f"curve is {curve!r}; expected one of {', '.join(get_args(Curve))}")
    picture = np.asarray(picture)
    if picture.dtype.kind not in "fub":
        raise InputError(
            f"a picture of {picture.dtype} values, whose white is unknown; convert it to uint8 "
            "or uint16, or divide it by its white"
        )
    white = float(np.iinfo(picture.dtype).max) if picture.dtype.kind == "u" else 1.0
    weights = picture / white
    if not ((weights >= 0) & (weights <= 1)).all():  # also rejects NaN
        raise InputError(
            f"a picture of {picture.dtype} values from {picture.min()} to {picture.max()}; "
            "fractions lie between 0 and 1: divide it by its white"
        )
    if curve == "srgb":
        low = weights <= 0.04045
        weights = np.where(low, weights / 12.92, ((weights + 0.055) / 1.055) ** 2.4)
    return weights.astype(np.float32)


def curve_slope(light: NDArray[np.floating], curve: Curve) -> NDArray[np.floating]:
    """Derivative of linear light with respect to a picture's number, both 0 to 1.

    `light` is linear; the result has its shape.
    """
    if curve == "linear":
        return np.ones_like(light)
    steep = 2.4 / 1.055 * np.maximum(light, 0) ** (1 - 1 / 2.4)
    return np.where(light <= 0.0031308, 1 / 12.92, steep)
