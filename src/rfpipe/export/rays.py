"""Selection of rays, for rows and columns of the transport matrix, by NumPy-like indices."""

from __future__ import annotations

import re

import numpy as np

from rfpipe.array_types import Index
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError


def rays_at(text: str, shape: tuple[int, ...]) -> Index:
    """Return the numbers of the rays that NumPy-like indices select.

    Parameters
    ----------
    text : str
        An index or slice for each axis: ``"31,35"`` is a pixel (row, column), ``"31,:"`` a row,
        ``"10:20,30:40"`` a rectangle, ``"::4,::4"`` every fourth pixel in both directions, and
        ``"2,31,35"`` a pixel of view 2.
    shape : tuple of int
        The ray domain.

    Returns
    -------
    ndarray of int64
        Rays in C order, at least one.

    Raises
    ------
    InputError
        When the text has another form, or selects no ray.
    """
    parts = text.replace(" ", "").split(",")
    axes = ",".join(["view"] * (len(shape) - 2) + ["row", "column"])
    if len(parts) != len(shape):
        raise InputError(
            f"rays {text!r}: {len(parts)} indices for rays of the shape {shape}; expected {axes}, "
            "each a number or a slice such as 10:20 or :"
        )
    numbers = np.arange(RayDomain(shape).size).reshape(shape)
    try:
        rays = np.asarray(numbers[tuple(_place(part, text) for part in parts)]).reshape(-1)
    except IndexError:
        raise InputError(f"rays {text!r}: outside the rays, whose shape is {shape}") from None
    except ValueError as error:
        raise InputError(f"rays {text!r}: {error}") from None
    if not rays.size:
        raise InputError(f"rays {text!r}: no ray of {shape} is there")
    return rays


def _place(part: str, text: str) -> int | slice:
    match = re.fullmatch(r"([+-]?\d+)|([+-]?\d+)?:([+-]?\d+)?(?::([+-]?\d+)?)?", part)
    if match is None:
        raise InputError(f"rays {text!r}: {part!r} is neither a number nor a slice such as 10:20")
    number, *ends = (None if end is None else int(end) for end in match.groups())
    return slice(*ends) if number is None else number
