"""An emulator of TI's DLPC900 controller, byte by byte, from its programmer's guide (DLPU018J)."""

from collections.abc import Callable
from io import BytesIO
from struct import unpack, unpack_from

import numpy as np


class Emulator:
    """The controller at the USB cable: receives packets, decodes images, shows patterns.

    Parameters
    ----------
    shape : (int, int)
        Number of rows and columns of mirrors.
    triggered : callable, optional
        Called at each pattern of a sequence with its duration in microseconds.
    """

    def __init__(
        self, shape: tuple[int, int], triggered: Callable[[int], None] = lambda microseconds: None
    ) -> None:
        self.shape = shape
        self.triggered = triggered
        self.status = 1
        self.is_silent = self.is_gone = False
        self.refused: set[int] = set()
        self.mode = 1
        self.running = False
        self.definitions: dict[int, bytes] = {}
        self.entries = self._shown = 0
        self.order: list[int] = []
        self.images: dict[int, np.ndarray] = {}
        self.commands: list[int] = []
        self._expected = (0, 0)
        self._image = b""
        self._message = b""
        self._answers: list[bytes] = []

    def write(self, report: bytes) -> int:
        """Receive a packet."""
        if self.is_gone:
            raise OSError("write error")
        assert len(report) == 65
        assert report[0] == 0, "the report's number"
        self._message += report[1:]
        length = unpack_from("<H", self._message, 2)[0]
        assert 6 <= 4 + length <= 512, "the controller's buffer"
        if len(self._message) >= 4 + length:
            message, self._message = self._message[: 4 + length], b""
            self._handle(message)
        return len(report)

    def read(self, length: int, timeout_ms: int) -> bytes:
        """Return the next reply."""
        del timeout_ms
        if self.is_silent or not self._answers:
            return b""
        return self._answers.pop(0)[:length]

    def close(self) -> None:
        """Close the connection."""
        self.is_gone = True

    @property
    def lit(self) -> np.ndarray | None:
        """Light of each mirror while a pattern is shown, 0 to 1."""
        if not self.running:
            return None
        definition = self.definitions[self._shown]
        depth, colour = (definition[5] >> 1 & 7) + 1, definition[5] >> 4 & 7
        assert colour == 7, "white"
        place = unpack("<H", definition[10:])[0]
        image, bit = place & 0x7FF, place >> 11
        assert bit + depth <= 24
        return (self.images[image] >> bit & (1 << depth) - 1) / ((1 << depth) - 1)

    def _handle(self, message: bytes) -> None:
        flags, number, _, command = unpack_from("<BBHH", message)
        data, answer = message[6:], b""
        self.commands.append(command)
        failed = command in self.refused
        if not failed:
            answer = self._done(command, data)
        if flags & 0x40:
            head = bytes([flags | 0x20 * failed, number]) + len(answer).to_bytes(2, "little")
            self._answers.append((head + answer).ljust(64, b"\0"))

    def _done(self, command: int, data: bytes) -> bytes:
        if command == 0x1A0A:
            return bytes([self.status])
        if command == 0x1A1B:
            assert not self.running, "stop before the mode is changed"
            self.mode = data[0]
        elif command == 0x1A24:
            self._start(data[0])
        elif command == 0x1A34:
            assert self.mode == 3
            assert len(data) == 12
            self.definitions[unpack("<H", data[:2])[0]] = data
        elif command == 0x1A31:
            assert not self.running, "stop before the table is configured"
            self.entries, repeats = unpack("<HI", data)
            assert set(range(self.entries)) <= set(self.definitions)
            self.order = []
            assert repeats == 0
        elif command == 0x1A32:
            count, shown = unpack("<HI", data[:6])
            self.order = list(unpack(f"<{count}H", data[6:]))
            assert count == shown == len(self.order)
            assert max(self.order) < self.entries
        elif command == 0x1A2A:
            self._expected, self._image = unpack("<HI", data), b""
        elif command == 0x1A2B:
            assert unpack("<H", data[:2])[0] == len(data) - 2 <= 504
            self._image += data[2:]
            if len(self._image) == self._expected[1]:
                self.images[self._expected[0]] = self._decoded(self._image)
        else:
            raise AssertionError(f"unknown command {command:#06x}")
        return b""

    def _start(self, action: int) -> None:
        self.running = action == 2
        if self.running and self.order:
            for index in self.order:
                self._shown = index
                self.triggered(int.from_bytes(self.definitions[index][2:5], "little"))
            self.running, self._shown = False, 0

    def _decoded(self, image: bytes) -> np.ndarray:
        """Undo the enhanced run-length encoding: (H, W) of 24 bits."""
        assert image[:4] == b"Spld"
        width, height, size = unpack("<HHI", image[4:12])
        assert (height, width) == self.shape
        assert image[25] == 2, "enhanced run-length encoding"
        data = BytesIO(image[48:])
        assert len(image) == 48 + size
        pixels = np.zeros((height * width, 3), np.uint32)
        done = 0
        while True:
            count = _number(data)
            if count:
                assert count > 1
                pixels[done : done + count] = list(data.read(3))
                done += count
                continue
            count = _number(data)
            if count == 0:
                done += -done % width
            elif count == 1:
                copied = _number(data)
                if copied == 0:
                    break
                pixels[done : done + copied] = pixels[done - width : done - width + copied]
                done += copied
            else:
                literal = np.frombuffer(data.read(3 * count), np.uint8).reshape(count, 3)
                pixels[done : done + count] = literal
                done += count
        assert done == height * width
        assert not data.read()
        red, green, blue = pixels.T
        return (red << 16 | green << 8 | blue).reshape(height, width)


def _number(data: BytesIO) -> int:
    """Read a number of one byte, or of two if the first one has its highest bit set."""
    first = data.read(1)[0]
    return first if first < 128 else first & 0x7F | data.read(1)[0] << 7
