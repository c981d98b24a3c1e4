"""Single rows and columns of the transport matrix as pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.transport.base import Light

Float = NDArray[np.float32]
Index = NDArray[np.int64]


def rays_at(text: str, shape: tuple[int, ...]) -> Index:
    """Return the numbers of the rays at a place of their domain, written as numpy's indices are.

    Parameters
    ----------
    text : str
        One index or slice an axis: ``"31,35"`` is a pixel (row, column), ``"31,:"`` a line,
        ``"10:20,30:40"`` a rectangle, ``"::4,::4"`` every fourth pixel; of views, ``"2,31,35"``.
    shape : tuple of int
        The ray domain.

    Returns
    -------
    ndarray of int64
        At least one ray, in C order; InputError if there is none, or the text is something else.
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
        found = np.asarray(numbers[tuple(_place(part, text) for part in parts)]).reshape(-1)
    except IndexError:
        raise InputError(f"rays {text!r}: outside the rays, whose shape is {shape}") from None
    except ValueError as error:
        raise InputError(f"rays {text!r}: {error}") from None
    if not found.size:
        raise InputError(f"rays {text!r}: no ray of {shape} is there")
    return found


def _place(part: str, text: str) -> int | slice:
    found = re.fullmatch(r"([+-]?\d+)|([+-]?\d+)?:([+-]?\d+)?(?::([+-]?\d+)?)?", part)
    if found is None:
        raise InputError(f"rays {text!r}: {part!r} is neither a number nor a slice such as 10:20")
    number, *ends = (None if end is None else int(end) for end in found.groups())
    return slice(*ends) if number is None else number


def ray_pictures(
    light: Light, side: Literal["row", "column"], rays: Index
) -> Iterator[tuple[tuple[int, ...], Float]]:
    """Yield rows or columns of T as pictures.

    Parameters
    ----------
    light : Light
    side : {"row", "column"}
        The row of a camera ray tells where its light comes from: a picture over the projector's
        rays. The column of a projector ray tells where its light goes: one over the camera's.
    rays : ndarray of int64
        Of the camera, or of the projector.

    Yields
    ------
    place : tuple of int
        Of the ray in its domain.
    picture : ndarray of float32, shape (height, width, C)
        Radiance per weight; several views stand one above the other.
    """
    is_row = side == "row"
    sides = light.camera_shape, light.projector_shape
    of_rays, seen = sides if is_row else sides[::-1]
    everything = np.arange(RayDomain(seen).size)
    rows, columns = (rays, everything) if is_row else (everything, rays)
    shape = (*RayDomain(seen).picture_shape, light.channels)
    for of_rows, of_columns, block in light.blocks(rows, columns, by_rows=is_row):
        lines = np.moveaxis(block, 0, -1) if is_row else block.transpose(2, 1, 0)
        for ray, line in zip(rays[of_rows if is_row else of_columns], lines, strict=True):
            place = tuple(int(index) for index in np.unravel_index(ray, of_rays))
            yield place, np.ascontiguousarray(line).reshape(shape)
