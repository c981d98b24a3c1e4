"""Directions of lights from their reflections in a chrome ball.

An orthographic camera looks along -z; x points right, y up, z to the camera. With ``n`` the normal
of the ball where the highlight is, and ``v = (0, 0, 1)`` the direction to the camera, the light
comes from ``l = 2 (n . v) n - v``. Each pixel of the ball reflects the same solid angle, 4 / R^2,
so that the mean of ``l`` over the pixels of a highlight is the centre of its lamp.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double
from rfpipe.errors import InputError

_SHARE = 0.5
"""Light, over that of the brightest pixel of the ball, from which on a pixel is of a highlight."""

_RIM = 0.97
"""Radius, over that of the ball, beyond which pixels may be of the background."""

_LARGEST = 0.1
"""Area of the largest highlight, over that of the ball; that of a matt ball is larger."""

_SECOND = 0.3
"""Light of a second highlight, over that of the first, from which on it is reported."""


class Ball(NamedTuple):
    """Circle of a ball in a picture: centre and radius in pixels; pixel centres are integers."""

    row: float
    column: float
    radius: float


class BallLight(NamedTuple):
    """Direction of a light, a unit vector, and of a second highlight of the ball, or None."""

    direction: Double
    second: Double | None


def ball_of_mask(mask: Bools) -> Ball:
    """Return the circle with the centre and the area of a mask (H, W); InputError if empty."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        raise InputError("the mask of the ball is empty")
    return Ball(float(rows.mean()), float(columns.mean()), float(np.sqrt(len(rows) / np.pi)))


def light_of_ball(picture: NDArray[np.floating], ball: Ball) -> BallLight:
    """Find the direction of the light that a chrome ball reflects.

    Parameters
    ----------
    picture : ndarray, shape (H, W) or (H, W, C)
        Light or sRGB; highlights may saturate.
    ball : Ball
        All of it is in the picture.

    Raises
    ------
    InputError
        If the circle is not within the picture, the ball is black, or its bright area is too large
        for a highlight.
    """
    from scipy.ndimage import label

    grey = np.asarray(picture, np.float64)
    grey = grey.max(axis=-1) if grey.ndim == 3 else grey
    lowest = min(ball.row, ball.column) - ball.radius
    highest = np.array([ball.row, ball.column]) + ball.radius - grey.shape
    if ball.radius <= 0 or lowest < -1 or highest.max() > 0:
        raise InputError(
            f"the ball at row {ball.row:g}, column {ball.column:g} with radius {ball.radius:g} is "
            f"not within the picture of {grey.shape[0]} x {grey.shape[1]} pixels"
        )
    rows, columns = np.indices(grey.shape)
    x, y = (columns - ball.column) / ball.radius, (ball.row - rows) / ball.radius
    inside = np.hypot(x, y) <= _RIM
    brightest = grey[inside].max()
    if brightest <= 0:
        raise InputError("the ball is black: no light is reflected")
    bright = inside & (grey >= _SHARE * brightest)
    labels, count = label(bright, np.ones((3, 3)))
    light = np.bincount(labels.ravel(), grey.ravel(), count + 1)[1:]
    order = np.argsort(-light)
    share = np.count_nonzero(labels == order[0] + 1) / np.count_nonzero(inside)
    if share > _LARGEST:
        raise InputError(
            f"the brightest area covers {share:.0%} of the ball, too much for a highlight: is the "
            "ball chrome, and its circle right?"
        )
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    reflected = np.stack([2 * z * x, 2 * z * y, 2 * z**2 - 1], axis=-1)

    def direction(index: int) -> Double:
        pixels = labels == index + 1
        total: Double = grey[pixels] @ reflected[pixels]
        return total / np.linalg.norm(total)

    has_second = count > 1 and light[order[1]] > _SECOND * light[order[0]]
    return BallLight(direction(order[0]), direction(order[1]) if has_second else None)
