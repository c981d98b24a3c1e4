"""Place of pictures on the rays of a coaxial rig: mirrored, shifted, or as the patterns are.

Resemblance of random patterns s, displaced by D, to the pictures y of them:

    c(D) = <D s, r> / (|s| |r|),    r = 2 y - f

====== =========== ========= ============================================================
symbol code        shape     meaning
====== =========== ========= ============================================================
s      signs       (n, H, W) 1 where a pattern is lit, else -1
y      pictures    (n, H, W) radiance under the patterns
f      floodlit    (H, W)    radiance under white
r      response    (n, H, W) radiance under s
c      resemblance ()        largest for the displacement D of the pictures
====== =========== ========= ============================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Double = NDArray[np.float64]

_REACH = 3  # rays by which a shift is looked for
_CLEAR = 2.0  # factor on the resemblance of a pattern as it is that another place must exceed
_SIGNIFICANT = 8.0  # standard deviations of a resemblance by chance
_FOLLOWS = 0.3  # share of a ray's light that changes with its own pattern, at least
_LIT = 0.01  # share of the mean light from which a ray is lit
_MOST, _OTHERS = 0.9, 0.7  # shares of rays without light of their own at an edge, and with it
_MISSED = 0.05  # share of such rays that is more than the edge of a picture


class Placement(NamedTuple):
    """Place on the rays of the pictures of random patterns.

    Attributes
    ----------
    name : str
        Such as "mirrored left to right" or "shifted by 1 ray right"; "" for in their place.
    missed : float
        Share of rays, in rows or columns at one edge, that have light but none of their own.
    edge : str
        That edge.
    """

    name: str = ""
    missed: float = 0.0
    edge: str = ""

    @property
    def text(self) -> str:
        """Description of a wrong place, "" for a right one."""
        if self.name:
            return f"its pictures are {self.name}"
        if self.missed > _MISSED:
            return (
                f"{self.missed:.0%} of the rays, at the {self.edge} edge, get no light of their "
                "own: the projector misses a part of its picture"
            )
        return ""


def placement_of(signs: Double, pictures: Double, floodlit: Double) -> Placement:
    """Compare pictures under random patterns with these patterns, mirrored and shifted.

    Parameters
    ----------
    signs : ndarray of float64, shape (n, H, W)
        1 where a pattern is lit, else -1.
    pictures, floodlit : ndarray of float64, shapes (n, H, W) and (H, W)
        Radiance, summed over channels.
    """
    response = 2 * pictures - floodlit
    norm = float(np.sqrt(np.square(response).sum() * signs.size))
    if norm == 0:
        return Placement()
    resemblance = {name: float((placed * response).sum()) / norm for name, placed in _placed(signs)}
    best = max(resemblance, key=lambda name: resemblance[name])
    least = max(_CLEAR * resemblance[""], _SIGNIFICANT / np.sqrt(signs.size))
    name = best if resemblance[best] > least else ""
    if name:
        return Placement(name)
    is_lit = floodlit > _LIT * floodlit.mean()
    follows = (signs * response).mean(axis=0) > _FOLLOWS * floodlit
    return Placement("", *_missed_edge(is_lit, follows))


def _missed_edge(is_lit: NDArray[np.bool_], follows: NDArray[np.bool_]) -> tuple[float, str]:
    """Find the edge from which most rays get no light of their own, and their share of all."""
    best = 0.0, ""
    for edge, turns in (("top", 0), ("right", 1), ("bottom", 2), ("left", 3)):
        lit, missing = (np.rot90(rays, turns).sum(axis=1) for rays in (is_lit, is_lit & ~follows))
        is_missed = (lit > 0) & (missing >= _MOST * lit)
        count = len(lit) if is_missed.all() else int(np.argmin(is_missed))
        others = np.rot90(follows, turns)[count:]
        if count and others.size and others.mean() > _OTHERS:
            best = max(best, (count / len(lit), edge))
    return best


def _placed(signs: Double) -> Iterator[tuple[str, Double]]:
    """Patterns in other places, with their names."""
    yield "", signs
    yield "mirrored left to right", signs[:, :, ::-1]
    yield "mirrored top to bottom", signs[:, ::-1]
    yield "turned upside down", signs[:, ::-1, ::-1]
    for down in range(-_REACH, _REACH + 1):
        for right in range(-_REACH, _REACH + 1):
            if (down or right) and abs(down) < signs.shape[1] and abs(right) < signs.shape[2]:
                name = f"shifted by {_way(down, 'down', 'up')}{_way(right, 'right', 'left')}"
                yield name.rstrip(), np.roll(signs, (down, right), axis=(1, 2))


def _way(rays: int, positive: str, negative: str) -> str:
    """Describe a shift along one axis, "" for none."""
    unit = "rays" if abs(rays) > 1 else "ray"
    return f"{abs(rays)} {unit} {positive if rays > 0 else negative} " if rays else ""
