"""Hardware sequences: lists of patterns that a projector shows and a camera exposes by triggers.

Triggers may be missed, and frames may be late, doubled or out of order. Therefore a list begins and
ends with a *marker*, the pictures white, black, black, white, and has another one in the middle. At
the shortest exposure, the second half of the list shows the complements of the patterns; a frame
and the frame of its complement must add up to the white picture. This requires no knowledge of the
scene. At longer exposures, each frame must agree with the next shorter exposure. All frames may be
late by the same number. Patterns whose frames are uncertain are played again, and finally captured
one by one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.base import Key
from rfpipe.rigs.devices import check_frame_shape
from rfpipe.rigs.stale import ExposureNoise, is_small
from rfpipe.units import SATURATION_FRACTION, SEQUENCE_KEY

OneByOne = Callable[[Float, Sequence[Key]], NDArray[Any]]

MARKER = (0, 1, 1, 0)
"""Indices of white and black among the loaded pictures."""

MOST_LAG = 4
"""Largest number of frames by which all frames may be late."""

SAME_PICTURE = 0.25
"""Accepted difference of two frames of one picture, relative to white minus black."""

REPLAYS = 3
"""Largest number of times that uncertain patterns are played again."""

_log = logging.getLogger(__name__)


class Player(Protocol):
    """Hardware, or its simulation, that shows lists of patterns and returns their frames."""

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:
        """Load patterns (N, *projector_shape), in place of the previous ones."""

    def play(self, order: Sequence[int], exposure: int) -> NDArray[Any]:
        """Show loaded patterns in this order, and return frames (n, ...) of one exposure.

        `exposure` is the index of the exposure. Frames may be missing, old or out of order.
        """


class Sequencer:
    """Captures brackets by hardware sequences, one list of patterns for each exposure.

    Parameters
    ----------
    player : Player
    sensor : Sensor
    one_by_one : callable
        ``one_by_one(patterns, keys)`` captures brackets without a sequence.
    limit : int
        Largest number of patterns in a list.

    Attributes
    ----------
    statistics : dict
        Numbers of ``played`` lists; of ``lost`` frames, which were uncertain and played again; and
        of patterns captured ``one_by_one``, after all repetitions.
    """

    def __init__(self, player: Player, sensor: Sensor, one_by_one: OneByOne, limit: int) -> None:
        self._player = player
        self._sensor = sensor
        self._one_by_one = one_by_one
        self.limit = limit
        self.statistics = {"played": 0, "lost": 0, "one_by_one": 0}

    def brackets(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Capture the brackets (B, E, ...) of patterns; CaptureError when a device fails."""
        starts = range(0, len(patterns), self.limit)
        lists = [slice(start, start + self.limit) for start in starts]
        return np.concatenate([self._list_brackets(patterns[part], keys[part]) for part in lists])

    def _list_brackets(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Capture the brackets of one list of patterns."""
        self._load(patterns, keys)
        exposures: list[dict[int, Any]] = self._play_exposures(len(patterns))
        indices = range(len(patterns))
        if missing := [i for i in indices if any(i not in frames for frames in exposures)]:
            names = ", ".join(str(tuple(keys[index])) for index in missing)
            _log.warning(
                "patterns %s are still uncertain after %d repetitions of their sequence; capturing "
                "them one by one", names, REPLAYS,
            )  # fmt: skip
            self.statistics["one_by_one"] += len(missing)
            brackets = self._one_by_one(patterns[missing], [keys[index] for index in missing])
            for number, frames in enumerate(exposures):
                frames |= {i: bracket[number] for i, bracket in zip(missing, brackets, strict=True)}
        return np.stack([[frames[i] for frames in exposures] for i in indices])

    def _load(self, patterns: Float, keys: Sequence[Key]) -> None:
        """Load white, black, the patterns and their complements."""
        uniform = np.stack([np.ones_like(patterns[0]), np.zeros_like(patterns[0])])
        all_keys: list[Key] = [(SEQUENCE_KEY, 0), (SEQUENCE_KEY, 1), *keys]
        all_keys += [(SEQUENCE_KEY, *key) for key in keys]
        self._player.load(np.concatenate([uniform, patterns, 1 - patterns]), all_keys)

    def _play_exposures(self, count: int) -> list[dict[int, NDArray[Any]]]:
        """Play the loaded patterns; return the certain frames of each exposure, by pattern."""
        per_exposure: list[dict[int, NDArray[Any]]] = []
        noise: list[ExposureNoise] = []
        indices = list(range(count))
        for number in range(len(self._sensor.exposures)):
            certain: dict[int, NDArray[Any]] = {}
            for _ in range(REPLAYS + 1):
                if missing := [index for index in indices if index not in certain]:
                    shorter = per_exposure[-1] if per_exposure else {}
                    certain |= self._play(count, missing, number, shorter, noise)
            per_exposure.append(certain)
            indices = sorted(certain)  # patterns lost at one exposure aren't played at longer ones
        return per_exposure

    def _play(
        self,
        count: int,
        displayed: Sequence[int],
        number: int,
        shorter_frames: dict[int, NDArray[Any]],
        noise: list[ExposureNoise],
    ) -> dict[int, NDArray[Any]]:
        """Play patterns at the exposure `number`, and return their certain frames.

        The first certain list of an exposure appends its noise to `noise`.
        """
        playlist = Playlist(count, displayed, with_complements=number == 0)
        raw = self._player.play(playlist.order, number)
        self.statistics["played"] += 1
        frames = raw.astype(np.float32)
        lag = playlist.lag(frames)
        certain: dict[int, NDArray[Any]] = {}
        if lag is not None:
            places = playlist.places(lag)
            shorter = noise[number - 1] if number else None
            saturated = SATURATION_FRACTION * self._sensor.white_level
            white, measured = playlist.marker_noise(frames, lag, saturated, shorter)
            if len(noise) == number:
                noise.append(measured)
            if shorter is None:
                indices = playlist.confirmed_by_complements(frames, lag, white, measured)
            else:
                ratio = self._sensor.exposures[number] / self._sensor.exposures[number - 1]
                indices = [
                    index
                    for index, place in places.items()
                    if measured.agrees(
                        frames[place], shorter_frames[index].astype(np.float32), shorter, ratio
                    )
                ]
            certain = {index: raw[places[index]] for index in indices}
        if uncertain := len(displayed) - len(certain):
            self.statistics["lost"] += uncertain
            _log.warning(
                "a sequence of %d frames at %g s gave %d: %d of its %d patterns are uncertain; "
                "playing them again%s",
                len(playlist.order), self._sensor.exposures[number], len(raw), uncertain,
                len(displayed),
                "" if lag is not None else " (the white and black pictures are missing: check that "
                "each picture triggers the camera, and that white is bright)",
            )  # fmt: skip
        return certain


@dataclass(frozen=True)
class Playlist:
    """A list of displayed patterns, and the assignment of frames to patterns.

    The loaded pictures are white, black, the patterns, and the complements of all patterns.

    Attributes
    ----------
    count : int
        Number of loaded patterns.
    displayed : sequence of int
        Indices of the patterns in this list.
    with_complements : bool
    """

    count: int
    displayed: Sequence[int]
    with_complements: bool

    @property
    def order(self) -> list[int]:
        """Indices of the loaded pictures in the order of display."""
        order = [*MARKER, *(2 + index for index in self.displayed), *MARKER]
        if self.with_complements:
            order += [*(2 + self.count + index for index in self.displayed), *MARKER]
        return order

    @property
    def markers(self) -> list[int]:
        """Positions in `order` at which markers begin."""
        step = len(MARKER) + len(self.displayed)
        return [0, step, 2 * step][: 2 + self.with_complements]

    def lag(self, frames: Float) -> int | None:
        """Number of frames by which all frames (n, ...) are late; None if frames are missing."""
        cells = np.stack([_cells(frame) for frame in frames]) if len(frames) else np.zeros((0, 1))
        lags, begins = range(MOST_LAG + 1), self.markers
        return next(
            (lag for lag in lags if all(_is_marker(cells, begin + lag) for begin in begins)), None
        )

    def places(self, lag: int, part: int = 0) -> dict[int, int]:
        """Index of the frame of each pattern (part 0) or complement (part 1)."""
        first = self.markers[part] + len(MARKER) + lag
        return {index: first + offset for offset, index in enumerate(self.displayed)}

    def marker_noise(
        self, frames: Float, lag: int, saturated: float, shorter: ExposureNoise | None
    ) -> tuple[Float, ExposureNoise]:
        """Mean white frame, and noise, estimated from the markers' frames."""
        starts = [begin + lag for begin in self.markers]
        whites = [start + offset for start in starts for offset in (0, 3)]
        white = np.stack([frames[place] for place in whites if place < len(frames)])
        black = np.stack([frames[start + offset] for start in starts for offset in (1, 2)])
        mean, dark, variance = white.mean(axis=0), black.mean(axis=0), _variance(black)
        if shorter is not None:  # a shorter exposure has fewer saturated pixels
            gain = shorter.gain
        else:
            usable = mean < saturated
            above = float((mean - dark)[usable].mean()) if usable.any() else 0.0
            noise = _variance(white[:, usable]) if usable.any() else 0.0
            gain = max(0.0, noise - variance) / above if above > 0 else 0.0
        return mean, ExposureNoise(dark, variance, gain, saturated)

    def confirmed_by_complements(
        self, frames: Float, lag: int, white: Float, noise: ExposureNoise
    ) -> list[int]:
        """Select patterns for which frame and complement add up to the white frame."""
        complements = self.places(lag, 1)
        return [
            index
            for index, place in self.places(lag).items()
            if _is_complement(frames[place], frames[complements[index]], white, noise)
        ]


def _is_complement(frame: Float, complement: Float, white: Float, noise: ExposureNoise) -> bool:
    """Test whether two frames add up to the white frame."""
    usable = np.maximum(np.maximum(frame, complement), white) < noise.saturated
    difference = np.where(usable, frame + complement - white - noise.black, 0)
    variance = 2 * (noise.variance(frame) + noise.variance(complement))
    total = min(noise.sum(frame), noise.sum(complement))
    return is_small(difference, variance, white - noise.black, total)


def _is_marker(cells: NDArray[np.float64], begin: int) -> bool:
    """Test whether the frames from `begin` on are white, black, black, white."""
    if begin + len(MARKER) > len(cells) + 1:
        return False
    # if all frames are late, the last one is missing
    white, black, second_black, *last = cells[begin : begin + len(MARKER)]
    second_white = last[0] if last else white
    contrast = float((white - black).sum())
    difference = max(np.abs(white - second_white).sum(), np.abs(black - second_black).sum())
    return contrast > 0 and float(difference) < SAME_PICTURE * contrast


def _cells(frame: NDArray[Any]) -> NDArray[np.float64]:
    """Sums over at most 32 x 32 cells of a frame, which have little noise."""
    image = frame.reshape(*frame.shape[-3:]) if frame.ndim > 3 else frame
    rows, columns = (
        np.arange(min(extent, 32)) * extent // min(extent, 32) for extent in image.shape[:2]
    )
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0, dtype=np.float64), columns, axis=1)
    return np.asarray(sums.ravel())


def _variance(frames: Float) -> float:
    """Variance of repeated frames of one picture, without the largest 1 % of the differences."""
    squares = np.square(np.diff(frames, axis=0).ravel().astype(np.float64))
    if not squares.size:
        return 0.0
    return float(squares[squares <= np.quantile(squares, 0.99)].mean() / 2)


class DevicePlayer:
    """Player on a projector and a camera with sequences, see `rfpipe.rigs.devices`.

    ``picture(pattern)`` converts a pattern to the projector's picture.
    """

    def __init__(self, projector: Any, camera: Any, picture: Callable[[Float], Float]) -> None:
        self._projector, self._camera, self._picture = projector, camera, picture

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:  # noqa: ARG002
        """Load the projector's pictures; devices don't need keys."""
        self._projector.load(self._picture(pattern) for pattern in patterns)

    def play(self, order: Sequence[int], exposure: int) -> NDArray[Any]:
        """Show and expose pictures; see `Player.play`."""
        camera = self._camera
        seconds = camera.sensor.exposures[exposure]
        camera.arm(seconds, len(order))
        try:
            self._projector.play(order, camera.seconds_between(seconds))
        finally:
            frames = np.asarray(camera.collect())  # also disarms the camera
        item = camera.sensor.frame_shape(camera.shape, camera.channels)[1:]
        return check_frame_shape(frames, (len(frames), *item), camera.sensor.frame_dtype)


def device_sequencer(
    projector: Any, camera: Any, picture: Callable[[Float], Float], one_by_one: OneByOne
) -> Sequencer:
    """Create the sequencer of a projector and a camera that is triggered by it."""
    limit = (projector.sequence_pictures - 2) // 2  # patterns and complements
    player = DevicePlayer(projector, camera, picture)
    return Sequencer(player, camera.sensor, one_by_one, limit)
