"""Access to picture files by OpenImageIO: specifications, metadata, and pixels as stored.

Every file is opened with a configuration: without one, OpenImageIO 3.2 multiplies colours by alpha
and reads PFM files upside down.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.records import Encoding, Header

FULL_SCALE = {
    "uint8": 2**8 - 1,
    "int8": 2**7 - 1,
    "uint16": 2**16 - 1,
    "int16": 2**15 - 1,
    "uint": 2**32 - 1,
    "int": 2**31 - 1,
}
"""Largest count of each integer type, by OpenImageIO's name."""

LIGHT = ("half", "float", "double")
"""Names of the types that hold light."""

LARGEST_BYTES = 2**35
"""Largest picture in memory, as OpenImageIO's own limit: larger ones are damaged headers."""

_EXPOSURE = ("ExposureTime", "Exif:ExposureTime", "expTime")
_ISO = (
    "Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings", "Exif:ISOSpeed",
    "Exif:RecommendedExposureIndex", "Exif:StandardOutputSensitivity", "isoSpeed",
)  # fmt: skip
_F_NUMBER = ("FNumber", "Exif:FNumber", "aperture")
_ISO_OVERFLOW = 65_535  # Exif's mark for a sensitivity that another tag holds


@dataclass(frozen=True)
class Stored:
    """A picture as it is stored in a file.

    Attributes
    ----------
    path : Path
    format_name : str
        OpenImageIO's name of the file's format, from its contents, such as ``tiff``.
    index : int
        Place in the file, from 0.
    spec : ImageSpec
    """

    path: Path
    format_name: str
    index: int
    spec: Any

    @property
    def is_light(self) -> bool:
        """True if the samples are floats."""
        return str(self.spec.format) in LIGHT

    @property
    def white(self) -> int:
        """Full scale of the samples; 1 of light. InputError for an unknown type."""
        kind = str(self.spec.format)
        if kind not in (*FULL_SCALE, *LIGHT):
            raise InputError(
                f"{self.path}: has samples of type {kind}; expected integers of 8 to 32 bits, or "
                "floats",
                remedy="Convert it to 16 bits",
            )
        return FULL_SCALE.get(kind, 1)

    def attribute(self, name: str) -> Any:
        """Return a metadata value, or None when it is missing or damaged."""
        try:
            return self.spec.getattribute(name)
        except UnicodeDecodeError:
            return None

    def number(self, *names: str) -> float | None:
        """Return the first finite number among metadata values of these names."""
        for name in names:
            value = np.asarray(self.attribute(name), object).ravel()[:1]
            if value.size and isinstance(value[0], int | float) and np.isfinite(value[0]):
                return float(value[0])
        return None

    def pixels(self) -> NDArray[Any]:
        """Read the samples.

        Returns
        -------
        ndarray of the file's type, shape (H, W, all channels)

        Raises
        ------
        InputError
            When the file ends early or its data are damaged, even where OpenImageIO fills in.
        """
        with _open(self.path) as file:
            if not file.seek_subimage(self.index, 0):
                raise InputError(f"{self.path}: can't be read as a picture: {_message(file)}")
            samples = file.read_image(self.index, 0, 0, self.spec.nchannels, self.spec.format)
            if (fault := _message(file)) or samples is None:
                raise InputError(
                    f"{self.path}: is cut or damaged, its pixels can't be read: {fault}",
                    remedy="Copy it again from the camera, or leave it out",
                )
            pixels: NDArray[Any] = samples
            return pixels


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Open a file as an ImageInput; failures of any kind raise InputError."""
    import OpenImageIO as oiio

    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected a picture")
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    file: Any = None
    try:
        file = oiio.ImageInput.open(str(path), config)
        if file is None:
            raise InputError(f"{path}: can't be read as a picture: {_message(oiio)}")
        yield file
    except (UnicodeDecodeError, MemoryError, OverflowError, RuntimeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: can't be read as a picture, its header is damaged: {error}",
            remedy="Copy it again from its source, or leave it out",
        ) from error
    finally:
        if file is not None:
            file.close()
        _message(oiio)


def _message(source: Any) -> str:
    """Return and clear the pending message of a file or of the library, on one line."""
    try:
        return " ".join(source.geterror().split())
    except UnicodeDecodeError:
        return "its header is damaged"


def stored_pictures(path: Path) -> list[Stored]:
    """Return the pictures in a file, without reduced copies (thumbnails) of TIFF.

    Raises
    ------
    InputError
        When the file is missing, is not a picture, or has a damaged header.
    """
    pictures = []
    with _open(path) as file:
        name, index = file.format_name(), 0
        while file.seek_subimage(index, 0):
            stored = Stored(path, name, index, file.spec(index))
            if not index or not int(stored.number("tiff:subfiletype") or 0) & 1:
                pictures.append(stored)
            index += 1
    for stored in pictures:
        _check_size(stored)
    return pictures


def _check_size(stored: Stored) -> None:
    """Raise InputError when a header states an impossible size, or deep data."""
    spec = stored.spec
    if spec.deep:
        raise InputError(
            f"{stored.path}: holds deep data", remedy="flatten it to one colour per pixel"
        )
    largest = max(spec.width * spec.height, spec.full_width * spec.full_height)
    if not 0 < 4 * spec.nchannels * largest <= LARGEST_BYTES or min(spec.width, spec.height) < 1:
        raise InputError(
            f"{stored.path}: states a size of {spec.height} x {spec.width} pixels in a window of "
            f"{spec.full_height} x {spec.full_width}; its header is damaged",
            remedy="Copy it again",
        )


def light_channels(stored: Stored) -> list[int]:
    """Return the indices of R, G and B, in this order, or of the single channel.

    Alpha is ignored. In EXR, which names channels, other channels are ignored, too; in other
    formats, one is read as alpha. More channels, or none of R, G and B, raise InputError.
    """
    names = list(stored.spec.channelnames)
    if stored.format_name != "openexr" and len(names) > 4:
        raise InputError(
            f"{stored.path}: has {len(names)} bands ({', '.join(names)}); expected one, or R, G "
            "and B",
            remedy="Save the bands that you mean as a picture",
        )
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGB"]
    light = [index for index, name in enumerate(names) if name != "A"]
    if len(light) == 1:
        return light
    raise InputError(f"{stored.path}: has the channels {names}; expected one channel, or R, G, B")


def header_of(
    stored: Stored, encoding: Encoding | None, size: tuple[int, int] | None = None
) -> Header:
    """Return the header of a picture.

    Parameters
    ----------
    stored : Stored
    encoding : str or None
        Transfer curve, as `profile_encoding` or the format has it.
    size : (int, int), optional
        Height and width, where they differ from those of the stored samples.
    """
    aperture = stored.number("Exif:ApertureValue", "Exif:MaxApertureValue")
    return Header(
        size or (stored.spec.height, stored.spec.width),
        len(light_channels(stored)),
        "light" if stored.is_light and stored.white else "counts",
        _exposure_seconds(stored),
        _sensitivity(stored),
        stored.number(*_F_NUMBER) or (2 ** (aperture / 2) if aperture else None),
        encoding,
        orientation=_orientation(stored),
    )


def _exposure_seconds(stored: Stored) -> float | None:
    """Return the exposure time, from Exif's ShutterSpeedValue, log2(1 / s), when it is missing."""
    seconds = stored.number(*_EXPOSURE)
    shutter = stored.number("Exif:ShutterSpeedValue")
    if not seconds and shutter is not None and abs(shutter) < 64:
        seconds = 2.0**-shutter
    return seconds if seconds and seconds > 0 else None


def _orientation(stored: Stored) -> int:
    """Return the orientation; 1 for Radiance files, whose reader applies it."""
    value = int(stored.number("Orientation") or 1)
    return value if 1 <= value <= 8 and stored.format_name != "hdr" else 1


def _sensitivity(stored: Stored) -> float | None:
    """Return the ISO sensitivity."""
    values = (stored.number(name) for name in _ISO)
    return next((value for value in values if value and 0 < value != _ISO_OVERFLOW), None)


def profile_encoding(stored: Stored) -> Encoding | None:
    """Return the transfer curve that an ICC profile, or else Exif, states; None for neither."""
    profile = stored.attribute("ICCProfile")
    if profile is not None:
        description = str(stored.attribute("ICCProfile:profile_description") or "").lower()
        if _is_linear(np.asarray(profile, np.uint8).tobytes()) or "linear" in description:
            return "linear"
        return "srgb" if "srgb" in description or "display p3" in description else "other"
    return "srgb" if stored.number("Exif:ColorSpace") == 1 else None


def _is_linear(profile: bytes) -> bool:
    """Test whether an ICC profile has a linear curve for red, or gray (ICC.1, 10.6 and 10.18)."""
    try:
        (count,) = struct.unpack_from(">I", profile, 128)
        entries = [
            struct.unpack_from(">4sI", profile, 132 + 12 * index) for index in range(min(count, 99))
        ]
        offset = next((place for tag, place in entries if tag in (b"rTRC", b"kTRC")), len(profile))
        kind, number, value = struct.unpack_from(">4s4xIH", profile, offset)
        if kind == b"curv":
            return bool(number == 0 or (number == 1 and value == 1 << 8))
        (gamma,) = struct.unpack_from(">i", profile, offset + 12)
        return bool(number >> 16 == 0 and gamma == 1 << 16)
    except struct.error:  # cut, or without a curve
        return False


Correction = Callable[[NDArray[Any]], NDArray[Any]]
"""A function from the stored samples, (H, W, channels), to those of the picture."""


def unchanged(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the samples as stored."""
    return pixels
