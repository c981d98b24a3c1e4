"""Hardware sequences of patterns: lost and reordered frames are detected and captured again."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig
from rfpipe.rigs.base import Key, capture_batch, check_patterns, sequence_patterns
from rfpipe.rigs.sequences import Sequencer
from rfpipe.stages import capture
from rfpipe.stages.capture import bracket_sets
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.results import write_result
from rfpipe.store import PictureStore
from rfpipe.testing import RigContract
from rfpipe.units import BLACK_LEVEL_KEY, SEQUENCE_KEY

RAYS = (12, 14)
COUNT = 13

Float = np.ndarray


class SimulatedSequences:
    """A simulated rig with hardware sequences that have random faults.

    A pattern's frames have the same bytes as frames of the rig without sequences. Captures
    therefore must not depend on sequences or on their faults.

    Parameters
    ----------
    rig : OperatorRig
    longest : int
        Largest number of patterns in a sequence.
    seed : int
    faults : float
        Probabilities of faults. For each frame: ``dropped``, its trigger is missed; ``twice``, it
        is delivered twice. For each sequence: ``late``, an old frame is delivered first and the
        last one is missing; ``swapped``, two of its frames are exchanged.
    """

    def __init__(
        self, rig: OperatorRig, longest: int = 199, seed: int = 0, **faults: float
    ) -> None:
        self._rig = rig
        self._chances = {"dropped": 0.0, "late": 0.0, "swapped": 0.0, "twice": 0.0, **faults}
        self._random = np.random.default_rng(seed)
        self._shown = 0
        self._old: Float | None = None
        self._sequencer = Sequencer(self, rig.sensor, rig.capture, longest)
        self.sequence_patterns = longest
        self.statistics = {"sequences": self._sequencer.statistics}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rig, name)

    def show_sequence(self, patterns: Float, keys: Sequence[Key]) -> Float:
        patterns = check_patterns(patterns, keys, self._rig.projector_shape)
        if not len(patterns):
            return self._rig.capture(patterns, keys)
        return self._sequencer.brackets(patterns, keys)

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:
        self._patterns, self._keys = patterns, list(keys)
        self._brackets: dict[Key, Float] = {}

    def play(self, order: Sequence[int], exposure: int) -> Float:
        keys = []
        for place in order:
            self._shown += 1  # codewords get a new key at each attempt
            key = self._keys[place]
            keys.append((*key, self._shown) if key[0] == SEQUENCE_KEY else key)
        new = {key: it for key, it in zip(keys, order, strict=True) if key not in self._brackets}
        if new:  # a bracket has all exposures, of which one is played
            brackets = self._rig.capture(self._patterns[list(new.values())], list(new))
            self._brackets.update(zip(new, brackets, strict=True))
        frames = np.stack([self._brackets[key] for key in keys])[:, exposure]
        came = self._gone_wrong(frames)
        self._old = frames[-1:]
        return came

    def _gone_wrong(self, frames: Float) -> Float:
        random, chances, count = self._random, self._chances, len(frames)
        order = list(range(count))
        if random.random() < chances["swapped"]:
            i, j = random.choice(count, 2, replace=False)
            order[i], order[j] = order[j], order[i]
        is_dropped = random.random(count) < chances["dropped"]
        times = 1 + (random.random(count) < chances["twice"])
        came = np.repeat(order, np.where(is_dropped, 0, times))
        if random.random() < chances["late"] and self._old is not None:
            return np.concatenate([self._old, frames[came]])[:count]
        return frames[came]


def rig(scene: str = "mixed") -> OperatorRig:
    """Return a rig of a scene: direct light only, mixed, or mostly indirect light."""
    random, rays = np.random.default_rng(7), RAYS[0] * RAYS[1]
    direct = np.diag(random.uniform(0.1, 1, rays))
    indirect = {
        "direct": 0,
        "mixed": 0.3 * random.random((rays, rays)) / rays,
        "cavity": 3 * np.outer(random.random(rays), random.random(rays)) / rays,
    }[scene]
    matrix = (0.3 if scene == "cavity" else 1.0) * direct + indirect
    return OperatorRig(matrix, RAYS, RAYS, CameraModel())


def patterns(kind: str) -> tuple[Float, list[tuple[int, int]]]:
    random = np.random.default_rng(3)
    shown = np.zeros((COUNT, *RAYS), np.float32)
    if kind == "half":
        shown[:] = random.random(shown.shape) < 0.5
    elif kind == "grey":
        shown[:] = random.random(shown.shape)
    elif kind == "one ray":
        shown.reshape(COUNT, -1)[np.arange(COUNT), random.permutation(shown[0].size)[:COUNT]] = 1
    else:
        shown[COUNT // 3 :] = 1
    return shown, [(1, index) for index in range(COUNT)]


FAULTS = {
    "a trigger is dropped": {"dropped": 0.02},
    "all come one late": {"late": 0.6},
    "two are exchanged": {"swapped": 0.7},
    "one comes twice": {"twice": 0.02},
    "all of it": {"dropped": 0.01, "late": 0.3, "swapped": 0.3, "twice": 0.005},
}


@pytest.mark.parametrize("scene", ["direct", "mixed", "cavity"])
@pytest.mark.parametrize("kind", ["half", "grey", "one ray", "black and white"])
def test_all_frames_are_certain_without_faults(scene: str, kind: str) -> None:
    plain, given = rig(scene), patterns(kind)
    sequences = SimulatedSequences(plain)
    np.testing.assert_array_equal(sequences.show_sequence(*given), plain.capture(*given))
    played = len(plain.sensor.exposures)
    assert sequences.statistics["sequences"] == {
        "played": played, "lost": 0, "one_by_one": 0
    }  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("scene", ["direct", "cavity"])
@pytest.mark.parametrize("kind", ["half", "grey", "one ray"])
def test_faults_are_detected_and_corrected(fault: str, scene: str, kind: str) -> None:
    plain, given, n_lost = rig(scene), patterns(kind), 0
    expected, radiance = without_sequences(scene, kind)
    for seed in range(2):
        sequences = SimulatedSequences(plain, seed=seed, **FAULTS[fault])
        frames = sequences.show_sequence(*given)
        differing = (frames != expected).any(axis=tuple(range(2, frames.ndim)))
        # completely saturated frames are equal for all patterns, so the merge is the same
        assert not differing[:, :2].any()
        if differing.any():
            np.testing.assert_allclose(merged(plain, frames), radiance, atol=1e-3 * radiance.max())
        n_lost += sequences.statistics["sequences"]["lost"]
    assert (n_lost > 0) is (fault != "all come one late")  # detectable by the codewords only


@cache
def without_sequences(scene: str, kind: str) -> tuple[Float, Float]:
    """Return frames of a rig without sequences, and their radiance."""
    plain = rig(scene)
    frames = plain.capture(*patterns(kind))
    return frames, merged(plain, frames)


def merged(plain: OperatorRig, frames: Float) -> Float:
    dark = plain.capture(np.zeros((4, *RAYS), np.float32), [(BLACK_LEVEL_KEY, i) for i in range(4)])
    mean = dark.mean(axis=0, dtype=np.float64).astype(np.float32)
    return plain.sensor.merge(frames, mean, 4).radiance


def test_patterns_without_certain_frames_are_captured_one_by_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    plain, given = rig(), patterns("half")
    for faults in ({"dropped": 1.0}, {"dropped": 0.3, "swapped": 1.0}):
        sequences = SimulatedSequences(plain, **faults)
        np.testing.assert_array_equal(sequences.show_sequence(*given), plain.capture(*given))
        assert sequences.statistics["sequences"]["one_by_one"] > 0
    assert "check that each picture triggers the camera" in caplog.text
    assert "capturing them one by one" in caplog.text


def test_long_lists_are_divided_and_single_patterns_need_no_sequence() -> None:
    plain, given = rig(), patterns("half")
    sequences = SimulatedSequences(plain, longest=5)
    np.testing.assert_array_equal(sequences.show_sequence(*given), plain.capture(*given))
    assert sequences.statistics["sequences"]["played"] == 3 * len(plain.sensor.exposures)
    assert sequences.show_sequence(given[0][:0], []).shape[0] == 0
    assert sequence_patterns(plain) == 0
    capture_batch(sequences, given[0][:1], given[1][:1])  # a single pattern needs no sequence
    assert sequences.statistics["sequences"]["played"] == 3 * len(plain.sensor.exposures)
    with pytest.raises(InputError, match="weights from 0 to 1"):
        sequences.show_sequence(given[0] + 1, given[1])


class TestSequencesAsARig(RigContract):
    def make_rig(self) -> SimulatedSequences:
        return SimulatedSequences(rig(), dropped=0.01, late=0.2, seed=1)


class Stopping(SimulatedSequences):
    """A rig that fails in the middle of its second sequence."""

    def show_sequence(self, shown: Float, keys: Any) -> Float:
        if self.statistics["sequences"]["played"]:
            raise KeyboardInterrupt
        return super().show_sequence(shown, keys)


def test_an_interrupted_capture_continues_at_its_sequence(tmp_path: Path) -> None:
    plain, (shown, _) = rig(), patterns("half")
    folder = FolderStorage(tmp_path / "scene" / "method")
    facts = {"stage": "schedule", "level": 1, "patterns": COUNT, "complete": False}
    facts |= {
        "shape": list(RAYS),
        "pattern_digest": "these",
        "seed": 1,
        "units": "fraction of full light",
    }
    write_result(folder.manifest(1, "schedule"), "these", {"weights": shown}, facts)
    with pytest.raises(KeyboardInterrupt):
        capture.run(CaptureContext(folder, rig_source=GivenRig(Stopping(plain, longest=5))), 1)
    [brackets] = bracket_sets(
        folder, 1, AcquisitionSettings(), folder.describe_rig(plain), is_exact=False
    )
    assert brackets.count_missing(folder) == COUNT - 5
    resumed = SimulatedSequences(plain, longest=5)
    capture.run(CaptureContext(folder, rig_source=GivenRig(resumed)), 1)
    assert resumed.statistics["sequences"]["played"] == 2 * len(plain.sensor.exposures)
    with PictureStore.open(folder.store(1, "capture")) as frames:
        np.testing.assert_array_equal(
            frames.read(0, COUNT), plain.capture(shown, [(1, i) for i in range(COUNT)])
        )
