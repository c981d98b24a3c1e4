"""Sequences: lists of patterns that a projector shows and a camera exposes in hardware.

Triggers are missed, frames come late, twice or in another order. So a list begins, is parted and
ends with a *word*: white, black, black, white. Each pattern is followed, half a list later, by its
complement: their pictures must add up to the white one. No scene and no geometry needs to be known
for that. At longer exposures, each frame must be what the one before promises. All frames may come
late by as many; what isn't told beyond doubt is played again, then taken one by one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.base import Key
from rfpipe.rigs.devices import check_frames
from rfpipe.rigs.stale import Light, is_little
from rfpipe.units import SATURATION_FRACTION, SEQUENCE_KEY

Float = NDArray[np.float32]
OneByOne = Callable[[Float, Sequence[Key]], NDArray[Any]]

WORD = (0, 1, 1, 0)
"""Places of white and black among the loaded pictures, which they begin."""

MOST_LAG = 4
"""Frames by which all may come late."""

ALIKE = 0.25
"""Difference of two pictures of one thing, as a share of that of white and black."""

REPLAYS = 3
"""How often missing patterns are played again."""

_log = logging.getLogger(__name__)


class Player(Protocol):
    """Shows lists of patterns, and returns the frames of them."""

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:
        """Take patterns (N, *projector_shape), in the place of those before."""

    def play(self, order: Sequence[int], exposure: int) -> NDArray[Any]:
        """Show them in this order, and return the frames of the exposure of that number.

        There may be fewer frames than patterns, old ones, and ones in another order.
        """


class Sequencer:
    """Takes brackets by sequences of at most `most` patterns: a list for each exposure.

    ``one_by_one(patterns, keys)`` takes brackets without a sequence. `statistics` counts ``played``
    lists; ``lost`` frames, which weren't told beyond doubt and were played again; ``one_by_one``:
    patterns that no sequence gave.
    """

    def __init__(self, player: Player, sensor: Sensor, one_by_one: OneByOne, most: int) -> None:
        self._player = player
        self._sensor = sensor
        self._one_by_one = one_by_one
        self.most = most
        self.statistics = {"played": 0, "lost": 0, "one_by_one": 0}

    def brackets(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Return the brackets (B, E, ...) of patterns; CaptureError where a device fails."""
        starts = range(0, len(patterns), self.most)
        lists = [slice(start, start + self.most) for start in starts]
        return np.concatenate([self._list(patterns[part], keys[part]) for part in lists])

    def _list(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        self._load(patterns, keys)
        frames: list[dict[int, Any]] = self._played(len(patterns))
        if missing := [i for i in range(len(patterns)) if any(i not in one for one in frames)]:
            names = ", ".join(str(tuple(keys[index])) for index in missing)
            _log.warning("patterns %s don't come by a sequence; taking them one by one", names)
            self.statistics["one_by_one"] += len(missing)
            brackets = self._one_by_one(patterns[missing], [keys[index] for index in missing])
            for number, of_exposure in enumerate(frames):
                of_exposure |= {
                    i: bracket[number] for i, bracket in zip(missing, brackets, strict=True)
                }
        return np.stack([[one[i] for one in frames] for i in range(len(patterns))])

    def _load(self, patterns: Float, keys: Sequence[Key]) -> None:
        """Load white, black, the patterns and their complements."""
        uniform = np.stack([np.ones_like(patterns[0]), np.zeros_like(patterns[0])])
        all_keys: list[Key] = [(SEQUENCE_KEY, 0), (SEQUENCE_KEY, 1), *keys]
        all_keys += [(SEQUENCE_KEY, *key) for key in keys]
        self._player.load(np.concatenate([uniform, patterns, 1 - patterns]), all_keys)

    def _played(self, count: int) -> list[dict[int, NDArray[Any]]]:
        """Play the loaded patterns; return the certain frames of each exposure, by place."""
        per_exposure: list[dict[int, NDArray[Any]]] = []
        lights: list[Light] = []
        indices = list(range(count))
        for number in range(len(self._sensor.exposures)):
            certain: dict[int, NDArray[Any]] = {}
            for _ in range(REPLAYS + 1):
                if missing := [index for index in indices if index not in certain]:
                    before = per_exposure[-1] if per_exposure else {}
                    certain |= self._certain(count, missing, number, before, lights)
            per_exposure.append(certain)
            indices = sorted(certain)  # what is lost at one exposure isn't asked for at the others
        return per_exposure

    def _certain(
        self,
        count: int,
        shown: Sequence[int],
        number: int,
        before: dict[int, NDArray[Any]],
        lights: list[Light],
    ) -> dict[int, NDArray[Any]]:
        """Play some patterns at one exposure; return the certain frames."""
        playlist = Playlist(count, shown, with_complements=number == 0)
        raw = self._player.play(playlist.order, number)
        self.statistics["played"] += 1
        frames = raw.astype(np.float32)
        lag = playlist.lag(frames)
        certain: dict[int, NDArray[Any]] = {}
        if lag is not None:
            places = playlist.places(lag)
            shorter = lights[number - 1] if number else None
            saturated = SATURATION_FRACTION * getattr(self._sensor, "white_level", np.inf)
            white, light = playlist.light(frames, lag, saturated, shorter)
            if len(lights) == number:
                lights.append(light)
            if shorter is None:
                indices = playlist.by_complements(frames, lag, white, light)
            else:
                ratio = self._sensor.exposures[number] / self._sensor.exposures[number - 1]
                indices = [
                    index
                    for index, place in places.items()
                    if light.is_promised(
                        frames[place], before[index].astype(np.float32), shorter, ratio
                    )
                ]
            certain = {index: raw[places[index]] for index in indices}
        if lost := len(shown) - len(certain):
            self.statistics["lost"] += lost
            _log.warning(
                "a sequence of %d frames at %g s gave %d: %d of its %d patterns aren't told beyond "
                "doubt; playing these again%s",
                len(playlist.order), self._sensor.exposures[number], len(raw), lost, len(shown),
                "" if lag is not None else " (white and black pictures weren't found: does each "
                "picture trigger the camera, and is white bright?)",
            )  # fmt: skip
        return certain


@dataclass(frozen=True)
class Playlist:
    """One list of `shown` patterns of the `count` that are loaded; which frame is of which pattern.

    Loaded are white, black, then the patterns, then the complements of all of them.
    """

    count: int
    shown: Sequence[int]
    with_complements: bool

    @property
    def order(self) -> list[int]:
        """Places of the loaded pictures in the order in which they are shown."""
        order = [*WORD, *(2 + index for index in self.shown), *WORD]
        if self.with_complements:
            order += [*(2 + self.count + index for index in self.shown), *WORD]
        return order

    @property
    def words(self) -> list[int]:
        """Where words begin in that order."""
        step = len(WORD) + len(self.shown)
        return [0, step, 2 * step][: 2 + self.with_complements]

    def lag(self, frames: Float) -> int | None:
        """Return by how many frames all of (n, ...) came late, or None where any was lost."""
        cells = np.stack([_cells(frame) for frame in frames]) if len(frames) else np.zeros((0, 1))
        lags, words = range(MOST_LAG + 1), self.words
        return next((lag for lag in lags if all(_is_word(cells, at + lag) for at in words)), None)

    def places(self, lag: int, part: int = 0) -> dict[int, int]:
        """Return which frame is of each pattern (part 0) or complement (part 1)."""
        first = self.words[part] + len(WORD) + lag
        return {index: first + at for at, index in enumerate(self.shown)}

    def light(
        self, frames: Float, lag: int, saturated: float, shorter: Light | None
    ) -> tuple[Float, Light]:
        """Return the mean white frame, and black and noise by the words' frames."""
        starts = [begin + lag for begin in self.words]
        whites = [start + at for start in starts for at in (0, 3)]
        white = np.stack([frames[place] for place in whites if place < len(frames)])
        black = np.stack([frames[start + at] for start in starts for at in (1, 2)])
        mean, dark, variance = white.mean(axis=0), black.mean(axis=0), _variance(black)
        if shorter is not None:  # where white was less saturated
            gain = shorter.gain
        else:
            usable = mean < saturated
            above = float((mean - dark)[usable].mean()) if usable.any() else 0.0
            noise = _variance(white[:, usable]) if usable.any() else 0.0
            gain = max(0.0, noise - variance) / above if above > 0 else 0.0
        return mean, Light(dark, variance, gain, saturated)

    def by_complements(self, frames: Float, lag: int, white: Float, light: Light) -> list[int]:
        """Return the patterns whose frame and their complement's add up to the white one."""
        complements = self.places(lag, 1)
        return [
            index
            for index, place in self.places(lag).items()
            if _is_complement(frames[place], frames[complements[index]], white, light)
        ]


def _is_complement(picture: Float, other: Float, white: Float, light: Light) -> bool:
    """Tell whether two frames add up to the white one."""
    usable = np.maximum(np.maximum(picture, other), white) < light.saturated
    off = np.where(usable, picture + other - white - light.black, 0)
    variance = 2 * (light.variance(picture) + light.variance(other))
    return is_little(off, variance, white - light.black, min(light.sum(picture), light.sum(other)))


def _is_word(cells: NDArray[np.float64], begin: int) -> bool:
    if begin + len(WORD) > len(cells) + 1:
        return False
    # the very last frame doesn't come where all come late
    white, black, black_again, *rest = cells[begin : begin + len(WORD)]
    white_again = rest[0] if rest else white
    contrast = float((white - black).sum())
    off = max(np.abs(white - white_again).sum(), np.abs(black - black_again).sum())
    return contrast > 0 and float(off) < ALIKE * contrast


def _cells(frame: NDArray[Any]) -> NDArray[np.float64]:
    """Return the sums of at most 32 x 32 cells of a frame, whose noise is little."""
    image = frame.reshape(*frame.shape[-3:]) if frame.ndim > 3 else frame
    rows, columns = (
        np.arange(min(extent, 32)) * extent // min(extent, 32) for extent in image.shape[:2]
    )
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0, dtype=np.float64), columns, axis=1)
    return np.asarray(sums.ravel())


def _variance(frames: Float) -> float:
    """Return the variance of a frame of one thing, few outliers aside."""
    squares = np.square(np.diff(frames, axis=0).ravel().astype(np.float64))
    if not squares.size:
        return 0.0
    return float(squares[squares <= np.quantile(squares, 0.99)].mean() / 2)


class DevicePlayer:
    """Plays lists on a projector and a camera that have sequences, see `rfpipe.rigs.devices`.

    ``picture(pattern)`` returns the projector's picture of a pattern.
    """

    def __init__(self, projector: Any, camera: Any, picture: Callable[[Float], Float]) -> None:
        self._projector, self._camera, self._picture = projector, camera, picture

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:  # noqa: ARG002
        """Give the projector its pictures; devices make their own noise, whatever the keys."""
        self._projector.load(self._picture(pattern) for pattern in patterns)

    def play(self, order: Sequence[int], exposure: int) -> NDArray[Any]:
        """Have pictures shown and taken; see `Player.play`."""
        camera = self._camera
        seconds = camera.sensor.exposures[exposure]
        camera.arm(seconds, len(order))
        try:
            self._projector.play(order, camera.seconds_between(seconds))
        finally:
            frames = np.asarray(camera.collect())  # also disarms it
        item = camera.sensor.frame_shape(camera.shape, camera.channels)[1:]
        return check_frames(frames, (len(frames), *item), camera.sensor.frame_dtype)


def device_sequencer(
    projector: Any, camera: Any, picture: Callable[[Float], Float], one_by_one: OneByOne
) -> Sequencer:
    """Return the sequencer of a projector and a camera that is triggered by it."""
    limit = (projector.sequence_pictures - 2) // 2  # each with its complement
    player = DevicePlayer(projector, camera, picture)
    return Sequencer(player, camera.sensor, one_by_one, limit)
