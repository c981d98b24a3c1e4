"""An emulation of ViALUX' ALP library, from its header: the functions that ALP4lib calls."""

# ruff: noqa: N802 - the names are the library's

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

NOT_ONLINE, NOT_IDLE, BAD_PARAMETER, NO_MEMORY = 1001, 1002, 1005, 1007
MIN_GREY_MICROSECONDS, MIN_BINARY_MICROSECONDS = 3500, 44


class Sequence:
    """Memory and settings of a sequence."""

    def __init__(self, bits: int, count: int, shape: tuple[int, int]) -> None:
        self.bits = bits
        self.pictures = np.full((count, *shape), np.nan)
        self.controls: dict[int, int] = {}
        self.microseconds = 33_334
        self.pulse = 0


class AlpLibrary:
    """The library with one controller at its cable.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of mirrors.
    triggered : callable, optional
        Called at each picture of a sequence with its duration in microseconds.
    """

    def __init__(
        self, shape: tuple[int, int], triggered: Callable[[int], None] = lambda microseconds: None
    ) -> None:
        self.shape, self.triggered = shape, triggered
        self.memory = 60
        self.lit: np.ndarray[Any, Any] | None = None
        self.fault = 0
        self.loads = 0
        self.table: list[int] = []
        self.sequences: dict[int, Sequence] = {}
        self._is_open = False
        self._last = 0

    def AlpDevAlloc(self, serial: Any, flag: int, device: Any) -> int:
        if self.fault:
            return self.fault
        self._is_open = True
        device._obj.value = 7
        return 0

    def AlpDevInquire(self, device: Any, kind: int, value: Any) -> int:
        known = {2021: 3, 2057: self.shape[0], 2058: self.shape[1], 2003: self.memory}
        value._obj.value = known[kind]
        return self._status(device)

    def AlpDevHalt(self, device: Any) -> int:
        self.lit = None
        return self._status(device)

    def AlpDevFree(self, device: Any) -> int:
        assert self.lit is None, "halt the device first"
        status, self._is_open = self._status(device), False
        return status

    def AlpSeqAlloc(self, device: Any, bits: Any, count: Any, number: Any) -> int:
        used = sum(len(sequence.pictures) * sequence.bits for sequence in self.sequences.values())
        if used + bits.value * count.value > self.memory:
            return NO_MEMORY
        self._last += 1
        self.sequences[self._last] = Sequence(bits.value, count.value, self.shape)
        number._obj.value = self._last
        return self._status(device)

    def AlpSeqFree(self, device: Any, number: Any) -> int:
        assert self.lit is None, "halt the device first"
        del self.sequences[number.value]
        return self._status(device)

    def AlpSeqControl(self, device: Any, number: Any, kind: int, value: Any) -> int:
        self.sequences[number.value].controls[kind] = value.value
        return self._status(device)

    def AlpSeqInquire(self, device: Any, number: Any, kind: int, value: Any) -> int:
        is_binary = self.sequences[number.value].bits == 1
        least = MIN_BINARY_MICROSECONDS if is_binary else MIN_GREY_MICROSECONDS
        value._obj.value = {2211: least, 2213: 10_000_000}[kind]
        return self._status(device)

    def AlpSeqPut(self, device: Any, number: Any, offset: Any, count: Any, data: Any) -> int:
        sequence = self.sequences[number.value]
        size = count.value * self.shape[0] * self.shape[1]
        codes = np.frombuffer(ctypes.string_at(data, size), np.uint8).astype(int)
        levels = codes >> 8 - sequence.bits  # the highest bits count
        place = slice(offset.value, offset.value + count.value)
        sequence.pictures[place] = levels.reshape(-1, *self.shape) / (2**sequence.bits - 1)
        self.loads += 1
        return self._status(device)

    def AlpSeqTiming(
        self, device: Any, number: Any, illumination: Any, picture: Any, delay: Any, pulse: Any,
        trigger_delay: Any,
    ) -> int:  # fmt: skip
        sequence = self.sequences[number.value]
        least = MIN_BINARY_MICROSECONDS if sequence.bits == 1 else MIN_GREY_MICROSECONDS
        if not least <= picture.value <= 10_000_000:
            return BAD_PARAMETER
        sequence.microseconds, sequence.pulse = picture.value, pulse.value
        return self._status(device)

    def AlpProjControlEx(self, device: Any, kind: int, data: Any) -> int:
        assert kind == 2325, "entries of 9 bits"
        numbers = np.frombuffer(ctypes.string_at(data, 4 * 4098), np.int32)
        offset, count = numbers[:2]
        assert offset == 0
        self.table = numbers[2 : 2 + count].tolist()
        return self._status(device)

    def AlpProjStartCont(self, device: Any, number: Any) -> int:
        self.lit = self.sequences[number.value].pictures[0]
        return self._status(device)

    def AlpProjStart(self, device: Any, number: Any) -> int:
        sequence = self.sequences[number.value]
        assert sequence.controls == {2104: 2106, 2118: 1, 2120: len(self.table)}
        assert 0 < sequence.pulse < sequence.microseconds, "the output returns to low"
        for index in self.table:
            self.lit = sequence.pictures[index]
            self.triggered(sequence.microseconds)
        return self._status(device)

    def AlpProjWait(self, device: Any) -> int:
        return self._status(device)

    def _status(self, device: Any) -> int:
        is_known = self._is_open and device.value == 7
        return self.fault or (0 if is_known else NOT_ONLINE)
