"""Where a series of pictures begins and ends, by the marker frames in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError

__all__ = ["first_bracket"]

# Two pictures show the same where they differ by less than this part of what the marker and its
# opposite do.
_SAME = 0.3

_Image = Callable[[int], NDArray[Any]]


def first_bracket(
    image: _Image, count: int, expected: int, step: int, name: str, firsts: Sequence[int]
) -> int:
    """Find the first picture of a series, marker, opposite, patterns, opposite.

    Parameters
    ----------
    image : callable
        ``image(index)`` is the light of the bracket that begins with a picture, float.
    count, expected : int
        Pictures there are, and of the series; `count` isn't smaller.
    step : int
        Pictures of a bracket.
    name : str
        Of the folder, for messages.
    firsts : sequence of int
        Pictures at which it may begin.

    Returns
    -------
    int
        Index of a picture.

    Raises
    ------
    CaptureError
        Where the markers stand in no place, in several, or the other way round.
    """
    found = [first for first in firsts if _frames(image, first, first + expected - step, step)]
    if len(found) == 1:
        return found[0]
    if found:
        raise CaptureError(
            f"{name}: the markers fit pictures {', '.join(str(first + 1) for first in found)} as "
            "the first; take away those that don't belong to the series"
        )
    last = count - step
    if count == expected and _same(image(0), image(last - step), image(last)):
        raise CaptureError(
            f"{name}: the markers stand the other way round: the pictures are in reverse order. "
            "Name them in the order in which they were taken"
        )
    raise CaptureError(
        f"{name}: the series doesn't begin with the marker and its opposite and end with the "
        "opposite, as it was to be shown: a picture is missing or out of order, or these are of "
        "another series. Names are sorted by the numbers in them"
    )


def _frames(image: _Image, first: int, last: int, step: int) -> bool:
    """Tell whether a series begins at one bracket and ends at another."""
    return _same(image(first + step), image(last), image(first))


def _same(one: NDArray[Any], other: NDArray[Any], opposite: NDArray[Any]) -> bool:
    """Tell whether two pictures are alike, beside one that should be their opposite."""
    apart = float(np.linalg.norm(opposite - other))
    return float(np.linalg.norm(one - other)) < _SAME * apart
