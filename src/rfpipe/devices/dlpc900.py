"""Projectors with TI's DLPC900 controller, such as the LightCrafter 6500, over USB.

The protocol follows the programmer's guide (DLPU018J); numbers are little-endian. A message to the
USB HID device has a header (flags, sequence byte, payload length), the command and its data, and is
split into packets of 64 bytes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from enum import IntEnum
from itertools import islice
from struct import pack, unpack
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.array_types import Codes
from rfpipe.config.base import Settings
from rfpipe.devices.bracket import load_library
from rfpipe.devices.dmd import DmdProjector
from rfpipe.errors import CaptureError

Device = Literal["DLP6500", "DLP670S"]

VENDOR, PRODUCT = 0x0451, 0xC900

SHAPES: dict[str, tuple[int, int]] = {"DLP6500": (1080, 1920), "DLP670S": (1600, 2716)}
"""Rows and columns of mirrors of the devices with a single controller."""

MAX_PICTURES = 236
"""Pictures loaded at a time: their order and the markers of a sequence must fit into a message."""

REPEAT_MICROSECONDS = 100_000
"""Display time of a picture that is repeated until the next one."""

MIN_MICROSECONDS, MAX_MICROSECONDS = 105, 2**24 - 1

ANSWER_MILLISECONDS = 2000

PACKET = 64
"""Size of a USB packet in bytes."""

MAX_DATA_BYTES = 504
"""Bytes of image data in a message: 512 without header, command and byte count."""

BITS_AN_IMAGE = 24
"""Binary pictures in one loaded image."""

_READ, _REPLY, _FAILED = 0x80, 0x40, 0x20
_WHITE = 0b111
_SIGNATURE = b"Spld"
_ENHANCED_RLE = 2

_STOP, _START = b"\0", b"\2"
_ON_THE_FLY = b"\3"
_ERRORS = 0b11001110
"""Error bits of the hardware status; its lowest bit means "initialised"."""


class Command(IntEnum):
    """Commands of the controller [DLPU018J]."""

    HARDWARE_STATUS = 0x1A0A
    DISPLAY_MODE = 0x1A1B
    DISPLAY_START = 0x1A24
    IMAGE_BEGIN = 0x1A2A
    IMAGE_DATA = 0x1A2B
    LUT_CONFIGURE = 0x1A31
    LUT_ORDER = 0x1A32
    LUT_DEFINE = 0x1A34


class Dlpc900Options(Settings):
    """A projector with TI's DLPC900 controller."""

    device: Device = Field(
        "DLP6500", description="Mirror array: DLP6500 (1080 x 1920) or DLP670S (1600 x 2716)."
    )
    serial: str | None = Field(
        None, min_length=1, description="Serial number of its USB device, or null for the only one."
    )
    settle_seconds: float = Field(
        0.05, ge=0, le=60, description="Wait after loading and starting a picture, in seconds."
    )


class Dlpc900Projector(DmdProjector):
    """A projector of 8-bit pictures, and of sequences of binary pictures that trigger the camera.

    Pictures are loaded into the controller's memory ("pattern on-the-fly"). The first trigger
    output is active during each picture of a sequence: connect it to the input that the camera's
    settings name. Tested with an emulator written from the guide DLPU018J, not with hardware.

    `Dlpc900Options` lists the options. `transport` replaces the USB device in tests, with
    ``write``, ``read`` and ``close`` of hidapi's `device`. CaptureError where no device responds.
    """

    Options = Dlpc900Options

    sequence_pictures = MAX_PICTURES

    def __init__(
        self,
        device: Device = "DLP6500",
        serial: str | None = None,
        settle_seconds: float = 0.05,
        transport: Any = None,
    ) -> None:
        super().__init__(settle_seconds)
        self.shape = SHAPES[device]
        self._device = device
        self._number = 0
        self._loaded = 0
        self._transport: Any = transport or open_usb(serial)
        try:
            self._send(Command.DISPLAY_START, _STOP)
            self._send(Command.DISPLAY_MODE, _ON_THE_FLY)
        except BaseException:
            self.close()
            raise

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the light."""
        return {"kind": "dlpc900", "device": self._device, "shape": list(self.shape)}

    def _show(self, codes: Codes, bits: int) -> None:
        self._load((codes >> bit & 1 == 1 for bit in range(bits)), bits)
        self._send(Command.DISPLAY_START, _START)

    def _microseconds(self) -> tuple[int, int]:
        return MIN_MICROSECONDS, MAX_MICROSECONDS

    def _play(self, order: Sequence[int], microseconds: int) -> None:
        self._send(Command.DISPLAY_START, _STOP)
        self._define(microseconds)
        order_of = pack("<HI", len(order), len(order)) + pack(f"<{len(order)}H", *order)
        self._send(Command.LUT_ORDER, order_of)
        self._send(Command.DISPLAY_START, _START)
        time.sleep(len(order) * microseconds / 1e6 + self.settle_seconds)
        self._check_status()
        self._send(Command.DISPLAY_START, _STOP)

    def _release(self) -> None:
        with suppress(Exception):
            for packet in message(Command.DISPLAY_START, _STOP, 0):
                self._transport.write(b"\0" + packet)
        self._transport.close()

    def _load(self, pictures: Iterator[NDArray[np.bool_]], bits: int = 1) -> None:
        """Load bit planes: the definitions first, then the images in reverse order."""
        images, count = [], 0
        while planes := list(islice(pictures, BITS_AN_IMAGE)):  # limits memory
            images.append(encoded_image(np.stack(planes)))
            count += len(planes)
        self._send(Command.DISPLAY_START, _STOP)
        self._loaded = count // bits
        self._define(REPEAT_MICROSECONDS, bits)
        for index, image in reversed(list(enumerate(images))):
            self._send(Command.IMAGE_BEGIN, pack("<HI", index, len(image)))
            for first in range(0, len(image), MAX_DATA_BYTES):
                part = image[first : first + MAX_DATA_BYTES]
                self._send(Command.IMAGE_DATA, pack("<H", len(part)) + part)

    def _define(self, microseconds: int, bits: int = 1) -> None:
        """Define every loaded picture as a pattern, repeated with this display time."""
        for index in range(self._loaded):
            entry = lut_entry(index, microseconds, index * bits, bits)
            self._send(Command.LUT_DEFINE, entry)
        self._send(Command.LUT_CONFIGURE, pack("<HI", self._loaded, 0))

    def _check_status(self) -> None:
        status = self._send(Command.HARDWARE_STATUS, b"", read=True)[0]
        if status & 1 == 0 or status & _ERRORS:
            raise CaptureError(
                f"projector: reports an error (hardware status {status:#04x}). Show sequences more "
                "slowly, or switch it off and on"
            )

    def _send(self, command: int, data: bytes, *, read: bool = False) -> bytes:
        """Send a message; return the data of the response."""
        self._number = (self._number + 1) % 256
        try:
            for packet in message(command, data, self._number, read=read):
                self._transport.write(b"\0" + packet)
            answer = bytes(self._transport.read(PACKET, ANSWER_MILLISECONDS))
        except (OSError, ValueError) as error:
            raise CaptureError(
                f"projector: the USB device is lost ({error}). Check its cable and power"
            ) from error
        if not answer:
            raise CaptureError(
                f"projector: no response to command {command:#06x} within "
                f"{ANSWER_MILLISECONDS / 1000:g} s. Check its cable and power"
            )
        return answer_of(answer, command, self._number)


def open_usb(serial: str | None) -> Any:
    """Open a DLPC900's USB device, or raise CaptureError."""
    device: Any = load_library("hid", "dlp").device()
    try:
        device.open(VENDOR, PRODUCT, serial)
    except OSError as error:
        raise CaptureError(
            f"projector: no DLPC900 responds on USB ({error}). Check cable and power, that this "
            "user may open the device (a udev rule for 0451:c900), and that no other program "
            "uses it"
        ) from error
    return device


def message(command: int, data: bytes, number: int, *, read: bool = False) -> list[bytes]:
    """Build the packets of a message, each of `PACKET` bytes."""
    flags = _REPLY | (_READ if read else 0)
    content = pack("<BBHH", flags, number, len(data) + 2, command) + data
    padded = content + bytes(-len(content) % PACKET)
    return [padded[first : first + PACKET] for first in range(0, len(padded), PACKET)]


def answer_of(packet: bytes, command: int, number: int) -> bytes:
    """Return the data of the response to a message; CaptureError for a refusal."""
    if len(packet) < 4:
        raise CaptureError(
            f"projector: responds with {len(packet)} bytes to command {command:#06x}"
        )
    flags, answered, length = unpack("<BBH", packet[:4])
    if flags & _FAILED:
        raise CaptureError(
            f"projector: refuses command {command:#06x}. Check that its firmware is that of a "
            "DLPC900, 3.0 or later, and that no other program uses it"
        )
    if answered != number:
        raise CaptureError(f"projector: responds to message {answered} instead of {number}")
    return packet[4 : 4 + length]


def lut_entry(index: int, microseconds: int, place: int, bits: int = 1) -> bytes:
    """Build the definition of a pattern in white light, with this display time.

    `place` is the index, among the loaded binary pictures, of the lowest of its 1 to 8 `bits`,
    which are in the same image. A trigger output is active while it is shown.
    """
    image, bit = divmod(place, BITS_AN_IMAGE)
    flags = 1 | (bits - 1) << 1 | _WHITE << 4  # dark afterwards; continues without a trigger
    return (
        pack("<H", index)
        + microseconds.to_bytes(3, "little")
        + bytes([flags])
        + bytes(3)  # no dark time
        + bytes(1)
        + pack("<H", image | bit << 11)
    )


def encoded_image(pictures: NDArray[np.bool_]) -> bytes:
    """Compress up to `BITS_AN_IMAGE` binary pictures (n, H, W) as one image."""
    _, height, width = pictures.shape
    values = np.zeros((height, width), np.uint32)
    for bit, picture in enumerate(pictures):
        values |= picture.astype(np.uint32) << np.uint32(bit)
    pixels = np.stack([values >> 16, values >> 8, values], axis=-1).astype(np.uint8)
    rows = b"".join(_encoded_rows(values, pixels))
    data = rows + bytes([0, 1, 0])
    header = (
        _SIGNATURE
        + pack("<HHI", width, height, len(data))
        + b"\xff" * 8
        + bytes(4)
        + bytes([0, _ENHANCED_RLE, 1])
    )
    return header + bytes(48 - len(header)) + data


def _encoded_rows(values: NDArray[np.uint32], pixels: NDArray[np.uint8]) -> Iterator[bytes]:
    width = values.shape[1]
    for row, line in enumerate(values):
        if row and np.array_equal(line, values[row - 1]):
            yield bytes([0, 1]) + _length(width)
            continue
        ends = np.append(np.flatnonzero(np.diff(line)) + 1, width)
        starts = np.insert(ends[:-1], 0, 0)
        if (ends - starts < 2).any():  # runs have at least 2 pixels: else uncompressed
            yield bytes([0]) + _length(width) + pixels[row].tobytes()
            continue
        for start, end in zip(starts, ends, strict=True):
            yield _length(int(end - start)) + pixels[row, start].tobytes()


def _length(count: int) -> bytes:
    """Encode a number of pixels in one or two bytes."""
    return bytes([count]) if count < 128 else bytes([count & 0x7F | 0x80, count >> 7])
