"""TI's DLPC900 against an emulator of it, byte by byte: its pictures, sequences and faults."""

from typing import Any

import numpy as np
import pytest
from tests.emulators.dlpc900 import Emulator
from tests.rigs.simulated_devices import SimulatedCamera

from rfpipe.devices import dlpc900
from rfpipe.devices.dlpc900 import Dlpc900Projector, lut_entry, message
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.rigs import DeviceRig, ProjectorLayout
from rfpipe.testing import ProjectorContract

SHAPE = (30, 44)
RAYS = (6, 8)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(dlpc900.SHAPES, "DLP6500", SHAPE)


def projector(emulator: Emulator) -> Dlpc900Projector:
    return Dlpc900Projector(settle_seconds=0, transport=emulator)


class TestDlpc900(ProjectorContract):
    def make_projector(self) -> Dlpc900Projector:
        self.emulator = Emulator(SHAPE)
        return projector(self.emulator)

    def read_back(self, shown: Any) -> Any:
        del shown
        return self.emulator.lit


def test_messages_match_the_programmers_guide() -> None:
    # tables 1-7 (a write that requests a reply) and 5.3 (two patterns) of the guide
    (packet,) = message(0x1100, bytes.fromhex("ff01ff01ff01"), 0x12)
    assert packet[:12] == bytes.fromhex("40 12 0800 0011 ff01ff01ff01")
    assert (len(packet), set(packet[12:])) == (64, {0})
    assert lut_entry(0, 200, 0) == bytes.fromhex("0000 c80000 71 000000 00 0000")
    assert lut_entry(1, 400, 1) == bytes.fromhex("0100 900100 71 000000 00 0008")
    assert lut_entry(25, 400, 25) == bytes.fromhex("1900 900100 71 000000 00 0108")
    assert len(message(0x1A2B, bytes(506), 0)) == 8


@pytest.mark.parametrize("count", [1, 24, 25, 60])
def test_sequences_are_displayed_in_any_order(count: int) -> None:
    random = np.random.default_rng(count)
    pictures = (random.random((count, *SHAPE)) < 0.5).astype(np.float32)
    pictures[0] = np.kron(random.random((3, 4)) < 0.5, np.ones((10, 11)))  # runs and equal rows
    exposures: list[np.ndarray] = []
    emulator = Emulator(SHAPE, lambda microseconds: exposures.append(emulator.lit * microseconds))
    with projector(emulator) as shown:
        shown.load(pictures)
        loads = emulator.commands.count(0x1A2A)
        order = random.integers(0, count, 9).tolist()
        shown.play(order, 150e-6)
        shown.play(order[:2], 200e-6)
        assert emulator.commands.count(0x1A2A) == loads == -(-count // 24)  # loaded once
    np.testing.assert_array_equal(np.stack(exposures[:9]), 150 * pictures[order])
    np.testing.assert_array_equal(np.stack(exposures[9:]), 200 * pictures[order[:2]])


def test_invalid_pictures_and_device_errors_are_explained() -> None:
    emulator = Emulator(SHAPE)
    with projector(emulator) as shown:
        grey = np.zeros((2, *SHAPE), np.float32)
        grey[1, 2, 3] = 0.5
        with pytest.raises(InputError, match=r"picture 1 is 0.5 at projector pixel \(2, 3\)"):
            shown.load(grey)
        with pytest.raises(InputError, match="holds at most 236 pictures"):
            shown.load(np.zeros((237, *SHAPE), np.float32))
        shown.load(np.zeros((2, *SHAPE), np.float32))
        with pytest.raises(CaptureError, match="not for 5e-05 s"):
            shown.play([0], 50e-6)
        for fault, message in (
            ({"status": 1 | 1 << 6}, r"reports an error \(hardware status 0x41\)"),
            ({"status": 1, "refused": {0x1A24}}, "refuses command 0x1a24"),
            ({"refused": set(), "is_silent": True}, "no response to command"),
            ({"is_gone": True}, "USB device is lost"),
        ):
            vars(emulator).update(fault)
            with pytest.raises(CaptureError, match=message):
                shown.play([0], 150e-6)


class TriggeredCamera(SimulatedCamera):
    """A camera of an emulated projector, with one frame per trigger and one pixel per mirror."""

    can_be_triggered = True

    def __init__(self, emulator: Any, missed: set[int]) -> None:
        self._emulator, self._missed = emulator, missed
        self._frames: list[np.ndarray] = []
        self._triggers, self._armed = 0, 0
        albedo = np.random.default_rng(0).uniform(0.1, 0.8, SHAPE)
        sensor = CameraModel(exposures=(1 / 512, 1 / 64))
        super().__init__(lambda: (albedo * emulator.lit)[..., None], SHAPE, 1, sensor)

    def seconds_between(self, exposure: float) -> float:
        return exposure

    def arm(self, exposure: float, count: int) -> None:
        self._armed = self.sensor.exposures.index(exposure)
        self._frames = []
        self._emulator.triggered = self._trigger

    def collect(self) -> np.ndarray:
        return np.stack(self._frames)

    def _trigger(self, microseconds: int) -> None:
        assert microseconds >= 1e6 * self.sensor.exposures[self._armed]
        self._triggers += 1
        if self._triggers not in self._missed:
            self._frames.append(self.expose()[self._armed])


MISSED = [set(), {13, 31}]
"""Triggers that the camera misses."""


def check_sequences(projector: Any, emulator: Any, missed: set[int]) -> None:
    """Compare patterns that a rig captures in sequences with those captured one by one."""
    camera: Any = TriggeredCamera(emulator, missed)
    layout = ProjectorLayout.grid(SHAPE, RAYS)
    patterns = (np.random.default_rng(1).random((11, *RAYS)) < 0.5).astype(np.float32)
    keys = [(1, index) for index in range(11)]
    with DeviceRig(projector, camera, layout) as rig:
        assert rig.sequence_patterns == (projector.sequence_pictures - 2) // 2
        frames = rig.show_sequence(patterns, keys).astype(float)
        counts = rig.statistics["sequences"]
        assert counts["one_by_one"] == 0
        assert (counts["lost"] > 0) is bool(missed)
        one_by_one = rig.capture(patterns, keys).astype(float)
        played = counts["played"]
        rig.show_sequence(0.5 * patterns, keys)  # grey: one by one
        assert rig.statistics["sequences"]["played"] == played
    step = np.abs(one_by_one[1:] - one_by_one[:-1]).mean()
    assert (np.abs(frames - one_by_one).mean(axis=(1, 2, 3, 4)) < 0.1 * step).all()


@pytest.mark.parametrize("missed", MISSED)
def test_a_rig_captures_binary_patterns_in_sequences(missed: set[int]) -> None:
    emulator = Emulator(SHAPE)
    check_sequences(projector(emulator), emulator, missed)
