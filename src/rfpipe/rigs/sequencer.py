"""Brackets by sequences: what hardware loses or mixes up is found, and taken again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.keys import SEQUENCE_KEY
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.base import Key
from rfpipe.rigs.sequence_frames import Frames, Light, Playlist, lags_of
from rfpipe.rigs.sequences import SequencePlayer

__all__ = ["Sequencer", "check_sequence", "patterns_within"]

Float = NDArray[np.float32]

REPLAYS = 3
"""How often what is missing of a sequence is played again before it is loaded again."""

LOADS = 2
"""How often it is loaded before what is still missing is taken one by one."""

SATURATION = 0.98
"""Of full scale."""

_log = logging.getLogger(__name__)


def patterns_within(pictures: int) -> int:
    """Return how many patterns fit among so many loaded pictures: each with its complement."""
    return max(0, (pictures - 2) // 2)


class Sequencer:
    """Takes brackets by sequences: a list for each exposure.

    Parameters
    ----------
    player : SequencePlayer
    sensor : Sensor
        Whose frames they are.
    one_by_one : callable
        ``one_by_one(patterns, keys)`` takes brackets without a sequence.

    Attributes
    ----------
    statistics : dict of str to int
        ``played``: lists; ``lost``: frames that weren't told beyond doubt, and were played again;
        ``loaded_again``: sequences; ``one_by_one``: patterns that no sequence gave.
    """

    def __init__(
        self,
        player: SequencePlayer,
        sensor: Sensor,
        one_by_one: Callable[[Float, Sequence[Key]], NDArray[Any]],
    ) -> None:
        self._player = player
        self._sensor = sensor
        self._one_by_one = one_by_one
        self.statistics = {"played": 0, "lost": 0, "loaded_again": 0, "one_by_one": 0}

    def brackets(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Return brackets (B, E, ...).

        Raises
        ------
        CaptureError
            When a device fails, or a pattern can't be taken one by one either.
        """
        frames: list[list[NDArray[Any] | None]] = [
            [None] * len(patterns) for _ in self._sensor.exposures
        ]
        missing = list(range(len(patterns)))
        for load in range(LOADS):
            self.statistics["loaded_again"] += load > 0
            self._load(patterns[missing], [keys[index] for index in missing])
            told = self._played(len(missing))
            for of_all, of_these in zip(frames, told, strict=True):
                for place, frame in of_these.items():
                    of_all[missing[place]] = frame
            missing = [index for index in missing if any(one[index] is None for one in frames)]
            if not missing:
                break
        if missing:
            names = ", ".join(str(tuple(keys[index])) for index in missing)
            _log.warning("patterns %s don't come by a sequence; taking them one by one", names)
            self.statistics["one_by_one"] += len(missing)
            taken = self._one_by_one(patterns[missing], [keys[index] for index in missing])
            for index, bracket in zip(missing, taken, strict=True):
                for exposure, frame in enumerate(bracket):
                    frames[exposure][index] = frame
        return np.stack([np.stack(one) for one in frames], axis=1)  # type: ignore[arg-type]

    def _load(self, patterns: Float, keys: Sequence[Key]) -> None:
        """Load white, black, the patterns and their complements."""
        uniform = np.stack([np.ones_like(patterns[0]), np.zeros_like(patterns[0])])
        all_keys: list[Key] = [(SEQUENCE_KEY, 0), (SEQUENCE_KEY, 1), *keys]
        all_keys += [(SEQUENCE_KEY, *key) for key in keys]
        self._player.load(np.concatenate([uniform, patterns, 1 - patterns]), all_keys)

    def _played(self, count: int) -> list[dict[int, NDArray[Any]]]:
        """Play the loaded patterns; return the frames of each exposure that are told, by place."""
        exposures = self._sensor.exposures
        taken: list[dict[int, NDArray[Any]]] = []
        lights: dict[int, Light] = {}
        shown = list(range(count))
        for number in range(len(exposures)):
            found: dict[int, NDArray[Any]] = {}
            for _ in range(REPLAYS + 1):
                missing = [index for index in shown if index not in found]
                if not missing:
                    break
                found |= self._told(count, missing, number, taken, lights)
            taken.append(found)
            shown = sorted(found)  # what is lost at one exposure isn't asked for at the others
        return taken

    def _told(
        self,
        count: int,
        shown: Sequence[int],
        number: int,
        taken: Sequence[dict[int, NDArray[Any]]],
        lights: dict[int, Light],
    ) -> dict[int, NDArray[Any]]:
        """Play some patterns at one exposure; return the frames that are told beyond doubt."""
        playlist = Playlist(count, shown, with_complements=number == 0)
        raw = self._player.play(playlist.order, number)
        self.statistics["played"] += 1
        linear = self._linear(raw)
        lags = lags_of(linear, playlist.words)
        places: dict[int, int] = {}
        if lags is not None:
            begins = [begin + lag for begin, lag in zip(playlist.words, lags, strict=True)]
            exposures, shorter = self._sensor.exposures, lights.get(number - 1)
            ratio = exposures[number] / exposures[number - 1] if number else 1.0
            light = Light.of(linear, begins, self._saturated, shorter)
            lights.setdefault(number, light)
            frames = Frames(linear, playlist, lags, light)
            if shorter is None:
                places = frames.by_complements()
            else:
                before = {index: self._linear(taken[number - 1][index]) for index in shown}
                places = frames.by_promise(before, shorter, ratio)
        lost = len(shown) - len(places)
        if lost:
            self.statistics["lost"] += lost
            _log.warning(
                "a sequence of %d frames at %g s gave %d: %d of its %d patterns aren't told beyond "
                "doubt; playing these again%s",
                len(playlist.order), self._sensor.exposures[number], len(raw), lost, len(shown),
                "" if lags is not None else " (white and black pictures weren't found: does each "
                "picture trigger the camera, and is white bright?)",
            )  # fmt: skip
        return {index: raw[place] for index, place in places.items()}

    @property
    def _saturated(self) -> float:
        white = getattr(self._sensor, "white_level", None)
        return np.inf if white is None else float(self._linear(np.float32(SATURATION * white)))

    def _linear(self, frames: Any) -> Any:
        """Return counts in proportion to light, from any black level on."""
        gamma = getattr(self._sensor, "response_gamma", 1.0)
        counts = np.asarray(frames, np.float32)
        if gamma == 1.0:
            return counts
        white, black = self._sensor.white_level, self._sensor.black_level_counts  # type: ignore[attr-defined]
        level = (counts - black) / np.float32(white - black)
        return np.copysign(np.abs(level) ** np.float32(gamma), level) * np.float32(white)


def check_sequence(
    frames: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Return what a camera collected, or raise CaptureError where that is no list of its frames."""
    if frames.shape[1:] != shape or frames.dtype != dtype:
        raise CaptureError(
            f"a sequence gave {frames.dtype} frames of shape {frames.shape[1:]}; expected {dtype} "
            f"{shape}. Check the camera's size and pixel format"
        )
    return frames
