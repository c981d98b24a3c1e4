"""Rectangles that stand and lie in a room, and blocks of them: x to the right, y down, z away."""

from __future__ import annotations

import numpy as np

from rfpipe.scenes.geometry import Rectangle, Vector

__all__ = ["block", "lying", "standing"]


def standing(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Return a rectangle that stands upright.

    Parameters
    ----------
    name, centre
        As of `Rectangle`.
    half
        Half its width and height, scene units.
    turned
        Where it faces, degrees: 0 is towards -z, 90 to the right.
    """
    return _rectangle(name, centre, half[0], (0.0, half[1], 0.0), turned)


def lying(name: str, centre: Vector, half: tuple[float, float], turned: float) -> Rectangle:
    """Return a rectangle that lies flat and faces up: half its width and depth; as `standing`."""
    sine, cosine = _turned(turned)
    return _rectangle(name, centre, half[0], (half[1] * sine, 0.0, -half[1] * cosine), turned)


def block(
    name: str, foot: Vector, *, side: float, height: float, turned: float
) -> tuple[Rectangle, ...]:
    """Return the four sides and the lid of a block with a square base.

    Parameters
    ----------
    name
        Of each of them.
    foot
        The middle of its base, scene units.
    side, height
        Of the base, and of the block, scene units.
    turned
        Where one of its sides faces, as of `standing`.
    """
    x, y, z = foot
    half = side / 2
    sides = []
    for angle in (turned, turned - 90, turned + 90, turned + 180):
        sine, cosine = _turned(angle)
        centre = (x + half * sine, y - height / 2, z - half * cosine)
        sides.append(standing(name, centre, (half, height / 2), angle))
    return (*sides, lying(name, (x, y - height, z), (half, half), turned))


def _turned(degrees: float) -> tuple[float, float]:
    """Sine and cosine of an angle."""
    return float(np.sin(np.radians(degrees))), float(np.cos(np.radians(degrees)))


def _rectangle(name: str, centre: Vector, half: float, down: Vector, turned: float) -> Rectangle:
    sine, cosine = _turned(turned)
    return Rectangle(name, centre, (half * cosine, 0.0, half * sine), down)
