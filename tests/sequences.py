"""A simulated rig with sequences in hardware, and what goes wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs.base import Key, Rig, check_patterns
from rfpipe.units import SEQUENCE_KEY
from rfpipe_devices.sequences import Sequencer

Float = NDArray[np.float32]


@dataclass(frozen=True)
class SequenceFaults:
    """How often a list goes wrong, each a probability from 0 to 1.

    Parameters
    ----------
    dropped : float
        Of each frame: its trigger is missed.
    late : float
        Of each list: its frames come one late, after an old one, and the last one not at all.
    swapped : float
        Of each list: two of its frames come in the other's place.
    twice : float
        Of each frame: it comes twice.
    seed : int
    """

    dropped: float = 0.0
    late: float = 0.0
    swapped: float = 0.0
    twice: float = 0.0
    seed: int = 0


class SimulatedSequences:
    """A simulated rig that shows and exposes lists of patterns, too.

    A pattern's frames are those of the rig itself, byte for byte: what is captured doesn't depend
    on whether it was by sequences, nor on their faults.

    Parameters
    ----------
    rig : Rig
        One whose noise depends on a pattern's key alone.
    most : int
        The most patterns of a sequence, at least 1.
    faults : SequenceFaults, optional

    Attributes
    ----------
    statistics : dict of str to dict
        Under "sequences" those of `Sequencer`.
    """

    def __init__(self, rig: Rig, most: int = 199, faults: SequenceFaults | None = None) -> None:
        self._rig = rig
        self.player = _SimulatedPlayer(rig, faults or SequenceFaults())
        self._sequencer = Sequencer(self.player, rig.sensor, rig.capture, most)
        self.sequence_patterns = most
        self.statistics = {"sequences": self._sequencer.statistics}

    def __getattr__(self, name: str) -> Any:
        """Return the attributes of a rig as the rig itself has them."""
        return getattr(self._rig, name)

    def show_sequence(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns by sequences; see `rfpipe.rigs.base.SequenceRig`."""
        patterns = check_patterns(patterns, keys, self._rig.projector_shape)
        if not len(patterns):
            return self._rig.capture(patterns, keys)
        return self._sequencer.brackets(patterns, keys)


class _SimulatedPlayer:
    """Plays lists by capturing them, then lets them go wrong."""

    def __init__(self, rig: Rig, faults: SequenceFaults) -> None:
        self._rig = rig
        self._faults = faults
        self._random = np.random.default_rng(faults.seed)
        self._shown = 0
        self._old: NDArray[Any] | None = None
        self._patterns: Float = np.zeros((0, *rig.projector_shape), np.float32)
        self._keys: list[Key] = []

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:
        self._patterns, self._keys = patterns, list(keys)

    def play(self, order: Sequence[int], exposure: int) -> NDArray[Any]:
        keys = [self._key(place) for place in order]
        frames = self._rig.capture(self._patterns[list(order)], keys)[:, exposure]
        came = self._gone_wrong(frames)
        self._old = frames[-1:]
        return came

    def _key(self, place: int) -> Key:
        """Return a pattern's own key, and a new one each time that anything else is shown."""
        key = tuple(self._keys[place])
        self._shown += 1
        return (*key, self._shown) if key[0] == SEQUENCE_KEY else key

    def _gone_wrong(self, frames: NDArray[Any]) -> NDArray[Any]:
        random, faults, count = self._random, self._faults, len(frames)
        order = list(range(count))
        if random.random() < faults.swapped:
            one, other = random.choice(count, 2, replace=False)
            order[one], order[other] = order[other], order[one]
        dropped, twice = random.random(count) < faults.dropped, random.random(count) < faults.twice
        came = [
            place for at, place in enumerate(order) if not dropped[at] for _ in range(1 + twice[at])
        ]
        picked: NDArray[Any] = frames[came]
        if random.random() < faults.late and self._old is not None:
            picked = np.concatenate([self._old, picked])[:count]
        return picked
