"""Which frame is of which pattern: told by what a sequence shows beside its patterns.

A sequence begins, is parted and ends with a *word*: white, black, black, white. Each pattern is
followed, half a sequence later, by its complement: their pictures must add up to that under white.
No scene and no geometry needs to be known for that, and two patterns that can be mistaken for each
other without any sum being off look alike. At longer exposures, each frame must be what the one
before promises. A frame that was lost or came late shifts those that follow, by as many as the
words tell.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLACK", "WHITE", "WORD", "Frames", "Light", "Playlist", "is_little", "lags_of"]

Float = NDArray[np.float32]

WHITE, BLACK = 0, 1
"""Places of the all-on and the all-off picture among the loaded ones."""

WORD = WHITE, BLACK, BLACK, WHITE

MOST_LAG = 4
"""Frames that may be lost, or be left over, before a sequence is taken for a failed one."""

ALIKE = 0.25
"""Difference of two pictures of one thing, as a share of that of white and black."""

CELLS = 32
"""Cells, along either side of an image, at which words are looked for: without its noise."""

SIGNIFICANCE = 6.0
"""Deviations of noise beyond which a pixel differs."""

TOLERANCE = 0.05
"""Share of the light by which it may differ beside: lamps flicker."""

ASTRAY = 0.02
"""Share of a picture's light that may be astray in all."""

PIXELS_ASTRAY = 0.1
"""Light under white of so many pixels that may, too."""


@dataclass(frozen=True)
class Playlist:
    """What a sequence shows: words, patterns, and maybe their complements.

    Loaded are white, black, then the patterns, then the complements of all of them.

    Parameters
    ----------
    count : int
        Patterns that are loaded.
    shown : sequence of int
        Those of them that are shown.
    with_complements : bool
    """

    count: int
    shown: Sequence[int]
    with_complements: bool

    @property
    def order(self) -> list[int]:
        """Places of the loaded pictures in the order in which they are shown."""
        first = 2
        order = [*WORD, *(first + index for index in self.shown), *WORD]
        if self.with_complements:
            order += [*(first + self.count + index for index in self.shown), *WORD]
        return order

    @property
    def words(self) -> list[int]:
        """Where words begin in that order."""
        step = len(WORD) + len(self.shown)
        return [0, step, 2 * step][: 2 + self.with_complements]

    def pattern(self, position: int) -> int:
        """Return where the pattern at a position of `shown` stands in that order."""
        return len(WORD) + position

    def complement(self, position: int) -> int:
        """Return where its complement stands."""
        return 2 * len(WORD) + len(self.shown) + position


@dataclass
class Light:
    """White, black and noise at one exposure.

    Attributes
    ----------
    white, black : ndarray of float32
        Means of the words' frames.
    black_variance : float
        Of a frame, in counts squared.
    gain : float
        Variance a count above black.
    saturated : float
        Counts from which on a pixel says no more.
    """

    white: Float
    black: Float
    black_variance: float
    gain: float
    saturated: float

    @classmethod
    def of(
        cls, frames: Float, words: Iterable[int], saturated: float, shorter: Light | None
    ) -> Light:
        """Learn from the words that begin at these frames.

        Parameters
        ----------
        frames : ndarray of float32, shape (n, ...)
        words : iterable of int
        saturated : float
        shorter : Light or None
            Of the exposure before, None for the shortest one.
        """
        starts = list(words)
        whites = [start + at for start in starts for at in (0, 3)]
        white = np.stack([frames[place] for place in whites if place < len(frames)])
        black = np.stack([frames[start + at] for start in starts for at in (1, 2)])
        mean, dark = white.mean(axis=0), black.mean(axis=0)
        dark_variance = _variance(black)
        if shorter is not None:  # where white was less saturated
            return cls(mean, dark, dark_variance, shorter.gain, saturated)
        usable = mean < saturated
        above = float((mean - dark)[usable].mean()) if usable.any() else 0.0
        variance = _variance(white[:, usable]) if usable.any() else 0.0
        gain = max(0.0, variance - dark_variance) / above if above > 0 else 0.0
        return cls(mean, dark, dark_variance, gain, saturated)

    def variance(self, counts: Float) -> Float:
        """Return the variance of a frame."""
        above = np.maximum(counts - self.black, 0)
        return np.asarray(self.black_variance + self.gain * above, np.float32)

    def is_complement(self, picture: Float, other: Float) -> bool:
        """Whether two frames add up to that under white."""
        usable = np.maximum(np.maximum(picture, other), self.white) < self.saturated
        off = np.where(usable, picture + other - self.white - self.black, 0)
        variance = 2 * (self.variance(picture) + self.variance(other))
        own = min(self._sum(picture), self._sum(other))
        return is_little(off, variance, self.white - self.black, own)

    def is_promised(
        self, picture: Float, before: Float, shorter: Light, ratio: float, share: float = ASTRAY
    ) -> bool:
        """Whether a frame is what that of a shorter exposure promises, up to saturation."""
        promised = self.black + np.float32(ratio) * (before - shorter.black)
        promised[before >= shorter.saturated] = self.saturated
        promised, seen = (np.minimum(one, self.saturated) for one in (promised, picture))
        variance = self.variance(seen) + np.float32(ratio**2) * shorter.variance(before)
        # what is saturated says nothing, and must not make room for the rest
        light = np.where(promised < self.saturated, np.maximum(promised - self.black, 0), 0)
        own = float(light.sum(dtype=np.float64))
        return is_little(seen - promised, variance, light, own, share)

    def _sum(self, picture: Float) -> float:
        return float(np.maximum(picture - self.black, 0).sum(dtype=np.float64))


@dataclass(frozen=True)
class Frames:
    """The frames that came of a sequence.

    Parameters
    ----------
    frames : ndarray of float32, shape (n, ...)
        In proportion to light, from any black level on.
    playlist : Playlist
    lags : list of int
        By how many frames each word came late; below 0 where frames before it were lost.
    light : Light
    """

    frames: Float
    playlist: Playlist
    lags: list[int]
    light: Light

    def by_complements(self) -> dict[int, int]:
        """Return which frame is of which pattern, of those that are told beyond doubt."""
        found = {}
        for position, index in enumerate(self.playlist.shown):
            pictures = {
                here
                for here in self._candidates(self.playlist.pattern(position), 0)
                if any(
                    self.light.is_complement(self.frames[here], self.frames[there])
                    for there in self._candidates(self.playlist.complement(position), 1)
                )
            }
            if len(pictures) == 1:
                found[index] = pictures.pop()
        return found

    def by_promise(self, before: dict[int, Float], shorter: Light, ratio: float) -> dict[int, int]:
        """Return the same by the frames of each pattern at a shorter exposure."""
        found = {}
        for position, index in enumerate(self.playlist.shown):
            pictures = [
                here
                for here in self._candidates(self.playlist.pattern(position), 0)
                if self.light.is_promised(self.frames[here], before[index], shorter, ratio)
            ]
            if len(pictures) == 1:
                found[index] = pictures[0]
        return found

    def _candidates(self, place: int, part: int) -> list[int]:
        """Return the frames that may be of a place between two words."""
        lags = self.lags[part : part + 2]
        near = range(place + min(lags), place + max(lags) + 1)
        return [here for here in near if 0 <= here < len(self.frames)]


def lags_of(frames: NDArray[Any], words: Sequence[int]) -> list[int] | None:
    """Return by how many frames each word came late, None where one isn't found.

    Parameters
    ----------
    frames : ndarray, shape (n, ...)
    words : sequence of int
        Where they should begin.
    """
    cells = np.stack([_cells(frame) for frame in frames]) if len(frames) else np.zeros((0, 1))
    lags = []
    for begin in words:
        near = sorted(range(-MOST_LAG, MOST_LAG + 1), key=abs)
        found = (lag for lag in near if _is_word(cells, begin + lag))
        lag = next(found, None)
        if lag is None:
            return None
        lags.append(lag)
    return lags


def _is_word(cells: NDArray[np.float64], begin: int) -> bool:
    if begin < 0 or begin + len(WORD) > len(cells) + 1:
        return False
    # the very last frame doesn't come where all come late
    white, black, black_again, *rest = cells[begin : begin + len(WORD)]
    white_again = rest[0] if rest else white
    contrast = float((white - black).sum())
    if contrast <= 0:
        return False
    off = max(np.abs(white - white_again).sum(), np.abs(black - black_again).sum())
    return float(off) < ALIKE * contrast


def is_little(off: Float, variance: Float, light: Float, own: float, share: float = ASTRAY) -> bool:
    """Whether what is astray is little beside the light in each place, and a picture's own.

    Parameters
    ----------
    off, variance : ndarray of float32
        Difference of two frames, and its variance.
    light : ndarray of float32
        What is expected in each place, from black on.
    own : float
        Sum of the picture's light.
    share : float
        Of it that may be astray.
    """
    off, light = np.abs(off), np.maximum(light, 0)
    beyond = off > SIGNIFICANCE * np.sqrt(variance) + TOLERANCE * light
    most = share * own + PIXELS_ASTRAY * float(light.mean(dtype=np.float64))
    return float(off[beyond].sum(dtype=np.float64)) <= most


def _cells(frame: NDArray[Any]) -> NDArray[np.float64]:
    """Average a frame over cells, ``(cells,)``."""
    image = frame.reshape(*frame.shape[-3:]) if frame.ndim > 3 else frame
    rows, columns = (
        np.arange(min(extent, CELLS)) * extent // min(extent, CELLS) for extent in image.shape[:2]
    )
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0, dtype=np.float64), columns, axis=1)
    return np.asarray(sums.ravel())


def _variance(frames: Float) -> float:
    """Return the variance of a frame of one thing, few outliers aside."""
    differences = np.diff(frames, axis=0).ravel()
    if not differences.size:
        return 0.0
    squares = np.square(differences.astype(np.float64))
    usual = squares <= np.quantile(squares, 0.99)
    return float(squares[usual].mean() / 2)
