"""Light paths: a light that moves over the projector's rays, pattern by pattern."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError

Float = NDArray[np.float32]

PATHS = {
    "across": "a vertical bar from left to right",
    "down": "a horizontal bar from top to bottom",
    "circle": "a disc around the middle",
    "views": "one view after the other, of a light field",
}
"""The paths that have a name."""

_SIZE = 1 / 8  # of the shorter side
_CIRCLE = 0.3  # radius, of height and width


@dataclass(frozen=True)
class LightPath:
    """Patterns of a light that moves, each made when it is asked for.

    Attributes
    ----------
    shape : tuple of int
        The projector's ray domain.
    count : int
        Number of patterns.
    at : callable
        Returns the weights, (H, W) or (*shape), at a time from 0 to 1.
    colour : tuple of float
        Weight of each channel; empty for white light.
    """

    shape: tuple[int, ...]
    count: int
    at: Callable[[float], Float]
    colour: tuple[float, ...] = ()

    def batch(self, first: int, last: int) -> Float:
        """Return patterns ``first:last``, ``(last - first, *shape[, channels])``."""
        times = np.arange(first, min(last, self.count)) / max(self.count - 1, 1)
        made = np.stack([np.broadcast_to(self.at(float(time)), self.shape) for time in times])
        if self.colour:
            return made[..., None] * np.array(self.colour, np.float32)
        return made


def light_path(
    path: str,
    shape: tuple[int, ...],
    count: int,
    size: float | None = None,
    colour: Sequence[float] = (),
) -> LightPath:
    """Return a light path by its name or its places.

    Parameters
    ----------
    path : str
        One of `PATHS`; or places ``"row,column row,column ..."`` in rays, two or more, between
        which a disc moves straight and evenly.
    shape : tuple of int
        The projector's ray domain. Views are lit alike, but by ``views``.
    count : int
        Number of patterns, at least 1.
    size : float, optional
        Width of a bar, diameter of a disc, in rays, above 0; by default an eighth of the shorter
        side.
    colour : sequence of float
        Weight of each channel, not negative; white by default.

    Raises
    ------
    InputError
        If the path is none, or a number is out of range.
    """
    domain = RayDomain(shape)
    height, width = domain.image_shape
    size = max(min(height, width) * _SIZE, 1.0) if size is None else size
    if not 0 < size < float("inf") or count < 1:
        raise InputError(f"a light path of size {size} in {count} patterns; expected more than 0")
    if not all(0 <= weight < float("inf") for weight in colour):
        raise InputError(f"colour {list(colour)}: expected weights that are not negative")
    if path == "views" and not domain.is_stack:
        raise InputError(f"path views: the projector's rays, {domain.shape}, are one image")
    rows, columns = np.ogrid[0:height, 0:width]

    def disc(row: float, column: float) -> Float:
        return _soft(np.hypot(rows - row, columns - column), size / 2)

    def bar(place: NDArray[np.int64], time: float) -> Float:
        middle = -size / 2 + time * (place.size - 1 + size)  # from outside to outside
        return np.broadcast_to(_soft(np.abs(place - middle), size / 2), (height, width))

    def circle(time: float) -> Float:
        down, right = -cos(2 * pi * time), sin(2 * pi * time)
        row = (height - 1) / 2 + _CIRCLE * height * down
        return disc(row, (width - 1) / 2 + _CIRCLE * width * right)

    def views(time: float) -> Float:
        weights = np.zeros(domain.stack_shape, np.float32)
        weights[min(int(time * domain.views), domain.views - 1)] = 1
        return weights.reshape(domain.shape)

    paths: dict[str, Callable[[float], Float]] = {
        "across": partial(bar, columns),
        "down": partial(bar, rows),
        "circle": circle,
        "views": views,
    }
    if path not in paths:
        places = _places(path)
        steps = np.hypot(*np.diff(places, axis=0).T)
        walked = np.append(0, np.cumsum(steps))
        paths[path] = lambda time: disc(
            *(float(np.interp(time * walked[-1], walked, axis)) for axis in places.T)
        )
    return LightPath(tuple(shape), count, paths[path], tuple(colour))


def _soft(distance: NDArray[np.float64], radius: float) -> Float:
    """Weights of what lies within a radius, its edge a ray wide, so that motion is smooth."""
    found: Float = np.clip(radius + 0.5 - distance, 0, min(1.0, 2 * radius)).astype(np.float32)
    return found


def _places(path: str) -> NDArray[np.float64]:
    """Return rows and columns of places, (n, 2)."""
    try:
        places = np.array([[float(part) for part in place.split(",")] for place in path.split()])
    except ValueError:
        places = np.empty(0)
    if places.ndim != 2 or len(places) < 2 or places.shape[1] != 2 or not np.isfinite(places).all():
        raise InputError(
            f"path {path!r}: expected {', '.join(PATHS)}, or two or more places as "
            "'10,12 40,55 20,60', each row,column"
        )
    return places
