"""Structured light by its name: Gray code and shifted sinusoids, as ``gray:1920x1080``.

A code's pictures have a fixed order: first the codes of columns, then the codes of rows.

- ``gray``: the bits from the most significant one, each followed by its complement, as
  ``cv2.structured_light.GrayCodePattern`` of OpenCV generates them; ``plain`` omits complements.
- ``phase``: for each period P (in projector pixels) the steps k = 0 ... n - 1 of the weights
  ``(1 + cos(2 pi (x / P - k / n))) / 2``, where x is the pixel's index from 0.

A white and a black picture may be anywhere among them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from rfpipe.array_types import Double, Float
from rfpipe.errors import InputError
from rfpipe.fitting.patterns import Patterns
from rfpipe.gray_code import gray_bits, gray_code

SYNTAX = (
    "gray:WIDTHxHEIGHT[,complements|plain] or phase:WIDTHxHEIGHT,period=P[+P...],steps=N, both "
    "with [,axis=columns|rows|both][,white=PICTURE|none][,black=PICTURE|none], where PICTURE is a "
    "number from 1, first or last; for example gray:1920x1080 or "
    "phase:1920x1080,period=32+1024,steps=4,white=last"
)
"""Grammar of the codes' names."""

_NAME = re.compile(r"(gray|phase):([1-9]\d{0,4})x([1-9]\d{0,4})((?:,[^,]+)*)")
_AXES = {"both": (1, 0), "columns": (1,), "rows": (0,)}
_SAME = 0.1  # share of the range of means up to which a picture is as bright as the brightest
_CLEARER = 3.0  # ratio of scatters from which one order of pictures is clearly better
_LEAST_STEPS = 3  # sinusoids from which a phase can be computed

PictureIndex = int | None  # index of a picture from 0, None without such a picture
Line = tuple[int, Float]  # axis (1 for columns, 0 for rows) and weights along it


@dataclass(frozen=True)
class _Code:
    """Settings of a code, read from its name.

    Attributes
    ----------
    name : str
        The code as the user wrote it.
    shape : (int, int)
        Rows and columns of the projector.
    axes : tuple of int
        Coded axes in their order, 1 for columns, 0 for rows.
    complements : bool or None
        Whether a complement follows each bit of the Gray code; None if not stated.
    periods : tuple of float
        Periods of the sinusoids in pixels; () for Gray code.
    steps : int
        Sinusoids of each period.
    white, black : str
        Places as written; "" if not stated.
    """

    name: str
    shape: tuple[int, int]
    axes: tuple[int, ...]
    complements: bool | None = None
    periods: tuple[float, ...] = ()
    steps: int = 4
    white: str = ""
    black: str = ""

    def lines(self, complements: bool) -> list[Line]:
        """Return the patterns except white and black, as lines along an axis."""
        lines: list[Line] = []
        for axis in self.axes:
            pixel = np.arange(self.shape[axis])
            if not self.periods:
                for bit in gray_code(pixel, gray_bits(len(pixel))).astype(np.float32):
                    lines += [(axis, bit), (axis, 1 - bit)] if complements else [(axis, bit)]
            for period, step in product(self.periods, range(self.steps)):
                phase = 2 * np.pi * (pixel / period - step / self.steps)
                lines.append((axis, (0.5 + 0.5 * np.cos(phase)).astype(np.float32)))
        return lines


def code_patterns(name: str, pictures: int, means: ArrayLike | None = None) -> Patterns:
    """Return the patterns of a code, one for each picture.

    Parameters
    ----------
    name : str
        The code, by the grammar of `SYNTAX`.
    pictures : int
        Number of pictures, white and black ones included. It decides whether there are
        complements, a white and a black picture, unless the name states it.
    means : array_like of float, shape (pictures,), optional
        Mean linear light of each picture. `place_white_and_black` identifies the white and the
        black picture by them, unless the name states their places.

    Returns
    -------
    Patterns
        Readers return read-only views (H, W) of float32 weights from 0 to 1.

    Raises
    ------
    InputError
        If the name is malformed, if no code or several have this number of pictures, or if white
        and black can't be identified.
    """
    code = _parse(name)
    lines, extras = _layout(code, pictures)
    boundary = sum(axis == code.axes[0] for axis, _ in lines)
    white, black = _places(code, pictures, extras, boundary, means)
    stated = bool(code.white and code.black)
    if (
        means is not None
        and not stated
        and len(lines) > 1
        and (lines[0][1] + lines[1][1] == 1).all()
    ):
        _check_sums(code, np.asarray(means, np.float64), white, black)
    readers = [partial(_spread, line, axis, code.shape) for axis, line in lines]
    for place, weight in sorted((p, w) for p, w in ((white, 1), (black, 0)) if p is not None):
        line = np.full(code.shape[1], weight, np.float32)
        readers.insert(place, partial(_spread, line, 1, code.shape))
    return Patterns(code.shape, readers)


def place_white_and_black(
    means: ArrayLike, candidates: Sequence[tuple[PictureIndex, PictureIndex]]
) -> tuple[PictureIndex, PictureIndex]:
    """Identify the white and the black picture by the pictures' mean light.

    White is among the brightest and black among the darkest pictures. A picture in the middle of a
    code may have been exchanged with white or black, which mean light can't exclude; so only
    candidates are considered.

    Parameters
    ----------
    means : array_like of float, shape (K,)
        Mean linear light of each picture.
    candidates : sequence of (int or None, int or None)
        Possible indices of white and black from 0, likeliest first; None for a missing picture.

    Returns
    -------
    white, black : int or None
        The first candidate that agrees with the means.

    Raises
    ------
    InputError
        If no candidate does.
    """
    light = np.asarray(means, np.float64)
    spread = np.ptp(light) if light.size else 0.0
    if not spread > 0:
        raise InputError(
            f"all {light.size} pictures have the same mean light: white and black can't be "
            "identified by it. State them, for example as white=29,black=30"
        )
    bright = light >= light.max() - _SAME * spread
    dark = light <= light.min() + _SAME * spread
    for white, black in candidates:
        if (white is None or bright[white]) and (black is None or dark[black]):
            return white, black
    brightest, darkest = int(light.argmax()) + 1, int(light.argmin()) + 1
    raise InputError(
        f"the brightest picture is number {brightest} and the darkest number {darkest}; white and "
        "black are expected as the last two pictures, the first two, at both ends, or between "
        "columns and rows. Mend the pictures' order, or state both places, for example as "
        f"white={brightest},black={darkest}"
    )


def _candidates(
    pictures: int, boundary: int, white: PictureIndex, black: PictureIndex, missing: str
) -> list[tuple[PictureIndex, PictureIndex]]:
    """Return possible places of white and black, likeliest first.

    The first pictures of a code have the coarsest stripes: they are as bright as white or as dark
    as black where the camera sees half of the projector. The last ones of each axis, whose stripes
    are the finest, never are; so places beside these come first.

    Parameters
    ----------
    pictures, boundary : int
        Number of all pictures, and of pictures that code the first axis.
    white, black : int or None
        Stated places.
    missing : {"", "white", "black", "either"}
        The one that isn't among the pictures.
    """
    last = pictures - 1
    if missing:
        ends = dict.fromkeys([last, boundary, 0])
        pairs: list[tuple[PictureIndex, PictureIndex]] = []
        for at in ends:
            pairs += [(at, None)] if missing != "white" else []
            pairs += [(None, at)] if missing != "black" else []
        return pairs
    if white is None and black is None:
        usual = [(last - 1, last), (0, last), (boundary, boundary + 1), (0, 1)]
        return [pair for a, b in usual for pair in ((a, b), (b, a))]
    free = sorted(set(range(pictures)) - {white, black}, key=lambda at: (0 < at < last, -at))
    return [(white, at) if black is None else (at, black) for at in free]


def _parse(name: str) -> _Code:
    """Read the settings of a code from its name; InputError teaches the grammar."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise _malformed(name, "it isn't kind:WIDTHxHEIGHT with options after commas")
    kind, width, height = match[1], int(match[2]), int(match[3])
    stated: dict[str, str] = {}
    for option in match[4].split(",")[1:]:
        key, _, value = option.strip().partition("=")
        if key in ("plain", "complements") and not value:
            key, value = "complements", key
        if key in stated:
            raise _malformed(name, f"it states {key} twice")
        stated[key] = value
    allowed = {"axis", "white", "black"} | (
        {"complements"} if kind == "gray" else {"period", "steps"}
    )
    unknown = sorted(set(stated) - allowed)
    if unknown:
        raise _malformed(name, f"{kind} has no option {unknown[0]!r}")
    if stated.get("axis", "both") not in _AXES:
        raise _malformed(name, f"axis={stated['axis']} is none of {', '.join(_AXES)}")
    if kind == "phase" and "period" not in stated:
        raise _malformed(name, "it lacks period=")
    order = stated.get("complements")
    return _Code(
        name,
        (height, width),
        _AXES[stated.get("axis", "both")],
        False if kind == "phase" else None if order is None else order == "complements",
        _periods(name, stated["period"]) if kind == "phase" else (),
        _steps(name, stated.get("steps", "4")),
        stated.get("white", ""),
        stated.get("black", ""),
    )


def _malformed(name: str, reason: str) -> InputError:
    """Return the error of a name that breaks the grammar."""
    return InputError(f"--patterns {name}: {reason}. Expected {SYNTAX}")


def _periods(name: str, value: str) -> tuple[float, ...]:
    """Return the periods of ``period=32+64``, in pixels."""
    try:
        periods = tuple(float(word) for word in value.split("+"))
    except ValueError:
        periods = ()
    if not periods or not all(1 < period < np.inf for period in periods):
        raise _malformed(
            name, f"period={value} isn't a number of pixels above 1, or several joined by +"
        )
    return periods


def _steps(name: str, value: str) -> int:
    """Return the number of sinusoids of a period."""
    if not value.isdecimal() or int(value) < _LEAST_STEPS:
        raise _malformed(name, f"steps={value} isn't a whole number from {_LEAST_STEPS}")
    return int(value)


def _layout(code: _Code, pictures: int) -> tuple[list[Line], int]:
    """Return the code's lines, and the number of white and black pictures beside them.

    InputError lists the possible numbers of pictures unless exactly one layout has `pictures`.
    """
    choices = (True, False) if code.complements is None else (code.complements,)
    places = (code.white, code.black)
    smallest = sum(place not in ("", "none") for place in places)
    largest = sum(place != "none" for place in places)
    layouts = [
        (lines, extras)
        for lines in map(code.lines, choices)
        for extras in range(smallest, largest + 1)
    ]
    fitting = [layout for layout in layouts if sum((len(layout[0]), layout[1])) == pictures]
    if len(fitting) == 1:
        return fitting[0]
    words = {True: "with complements", False: "without complements"}
    listed = "; ".join(
        f"{len(lines) + extras} pictures: {len(lines)} of the code"
        + (f" {words[len(lines) > len(layouts[-1][0])]}" if len(choices) > 1 else "")
        + ("", " and a white or black one", ", white and black")[extras]
        for lines, extras in layouts
    )
    several = "several layouts have" if fitting else "no layout has"
    raise InputError(
        f"--patterns {code.name}: {several} {pictures} pictures. Possible are {listed}. State "
        f"the layout, or take pictures away. The syntax is {SYNTAX}"
    )


def _places(
    code: _Code, pictures: int, extras: int, boundary: int, means: ArrayLike | None
) -> tuple[PictureIndex, PictureIndex]:
    """Return the indices of white and black, stated or identified by mean light."""
    white, black = (
        None if place in ("", "none") else _index(code, place, pictures)
        for place in (code.white, code.black)
    )
    if white is not None and white == black:
        raise InputError(f"--patterns {code.name}: picture {white + 1} can't be white and black")
    if extras == (white is not None) + (black is not None):
        return white, black
    if means is None:
        raise InputError(
            f"--patterns {code.name}: {extras} of the {pictures} pictures are white or black. "
            "State which, for example as white=29,black=30, or white=last"
        )
    light = np.asarray(means, np.float64)
    if light.shape != (pictures,):
        raise InputError(f"means: an array {light.shape}; expected one for each picture")
    excluded = [kind for kind in ("white", "black") if getattr(code, kind) == "none"]
    missing = "" if extras == 2 else excluded[0] if excluded else "either"
    try:
        return place_white_and_black(light, _candidates(pictures, boundary, white, black, missing))
    except InputError as error:
        raise InputError(f"--patterns {code.name}: {error}") from None


def _check_sums(code: _Code, light: Double, white: PictureIndex, black: PictureIndex) -> None:
    """Refuse means (K,) of Gray code with complements whose white or black was exchanged.

    A picture and its complement have white's light together. Where one of white and black is at
    an unusual place, these sums scatter less after its exchange with one of the last two pictures.
    """
    ends = {len(light) - 2, len(light) - 1}
    if white is None or black is None or not {white, black} & ends or {white, black} <= ends:
        return
    odd = white if white not in ends else black
    [usual] = ends - {white, black}
    exchanged = light.copy()
    exchanged[[odd, usual]] = exchanged[[usual, odd]]

    def scatter(means: Double, places: list[int]) -> float:
        """Return the relative scatter of sums, without white and black."""
        sums = np.delete(means, places).reshape(-1, 2).sum(axis=1)
        return float(sums.std() / sums.mean())

    present, without = scatter(light, [white, black]), scatter(exchanged, list(ends))
    if present > _CLEARER * without:
        raise InputError(
            f"--patterns {code.name}: picture {odd + 1} seems exchanged with {usual + 1}: the mean "
            f"light of pictures and their complements scatters by {100 * present:.1f} %, after "
            f"their exchange by {100 * without:.1f} %. Mend the order, or state both places, as "
            f"white={white + 1},black={black + 1}"
        )


def _index(code: _Code, place: str, pictures: int) -> int:
    """Return the index from 0 of a stated place; InputError if it doesn't exist."""
    number = {"first": "1", "last": str(pictures)}.get(place, place)
    if not number.isdecimal() or not 1 <= int(number) <= pictures:
        raise _malformed(code.name, f"{place!r} isn't one of its {pictures} pictures")
    return int(number) - 1


def _spread(line: Float, axis: int, shape: tuple[int, int]) -> Float:
    """Return a pattern (H, W) whose weights along an axis are `line`, without a copy."""
    return np.broadcast_to(np.expand_dims(line, 1 - axis), shape)
