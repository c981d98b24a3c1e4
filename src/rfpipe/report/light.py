"""Light in figures: radiance with its exposure, tone-mapped for screens and kept in OpenEXR."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError
from rfpipe.store.files import hidden_sibling
from rfpipe.units import RADIANCE_UNIT

__all__ = [
    "ERROR_COLOURS",
    "ERROR_LABEL",
    "Light",
    "error_map",
    "exposure_text",
    "read_exr",
    "round_limit",
    "tone_mapped",
    "write_exr",
]

ERROR_COLOURS = "RdBu_r"
"""Colours of error maps: blue where a relit picture is too dark, red where it is too bright."""

ERROR_LABEL = "relit \N{MINUS SIGN} truth,\n% of white"
"""What stands at the scale of an error map."""

_SHOWN = 99.0  # percentile of an error map's magnitudes that its scale reaches at least
_LEAST_LIMIT = 1e-5  # of white: a scale for pictures without any error
_GREY, _COLOUR = ("Y",), ("R", "G", "B")


@dataclass(frozen=True)
class Light:
    """A picture of light in a figure.

    Attributes
    ----------
    of : str
        The scene.
    what : str
        Which picture of it, such as "relit"; with `of` unique in its figure.
    radiance : ndarray of float, shape (H, W, C)
        Linear; C is 1 or 3. Goes into the OpenEXR file as it is.
    white : float
        Radiance shown as white, above 0: the exposure.
    gain : ndarray of float, shape (H, W), or float
        Factor by which pixels are brightened for the screen, to show indirect light.
    quantity : str
        What the numbers are, where they aren't radiance.
    """

    of: str
    what: str
    radiance: NDArray[Any]
    white: float
    gain: NDArray[Any] | float = 1.0
    quantity: str = RADIANCE_UNIT

    @property
    def name(self) -> str:
        """Name of the picture in its figure, and of its part of the OpenEXR file."""
        return f"{self.of}, {self.what}"

    @property
    def shown(self) -> NDArray[np.float64]:
        """The picture as sRGB in [0, 1], shape (H, W, 3)."""
        gain = np.asarray(self.gain)
        return tone_mapped(self.radiance * gain.reshape(*gain.shape, 1), self.white)


def tone_mapped(radiance: NDArray[Any], white: float) -> NDArray[np.float64]:
    """Render radiance for a screen by colour-science's curve of sRGB (IEC 61966-2-1).

    The colour library takes seconds to load, once in a process.

    Parameters
    ----------
    radiance : ndarray of float, shape (*shape, C)
        C is 1 or 3.
    white : float
        Radiance shown as white; more is cut off.

    Returns
    -------
    ndarray of float64, shape (*shape, 3)
        In [0, 1].
    """
    import colour

    linear = np.clip(np.asarray(radiance, np.float64) / white, 0, 1)
    encoded = np.asarray(colour.cctf_encoding(linear, function="sRGB"), np.float64)
    return np.broadcast_to(encoded, (*encoded.shape[:-1], 3))


def exposure_text(lights: Iterable[Light]) -> str:
    """Say in a sentence what a figure's pictures of light show as white; "" without any."""
    scenes: dict[str, None] = {}
    whites: dict[str, dict[str, list[str]]] = {}
    for light in lights:
        scenes[light.of] = None
        of_white = whites.setdefault(light.quantity, {}).setdefault(f"{light.white:.3g}", [])
        if light.of not in of_white:
            of_white.append(light.of)
    if not whites:
        return ""
    said = [
        f"{quantity} "
        + ", ".join(
            white if len(some) == len(scenes) else f"{white} ({', '.join(some)})"
            for white, some in of_quantity.items()
        )
        for quantity, of_quantity in whites.items()
    ]
    return f"Exposure: white is {' and '.join(said)}; sRGB tones."


def error_map(relit: Light, truth: Light) -> NDArray[np.float64]:
    """Return relit minus true radiance over white, brightened as the relit picture is.

    Returns
    -------
    ndarray of float64, shape (H, W)
        The mean over the channels.
    """
    difference = np.asarray(relit.radiance, np.float64) - truth.radiance
    return np.asarray(difference.mean(axis=-1) * relit.gain / relit.white)


def round_limit(maps: Sequence[NDArray[Any]]) -> float:
    """Return the end of a colour scale for some error maps: 1, 2 or 5 times a power of ten.

    All but the largest hundredth of the magnitudes lie within it.
    """
    magnitudes = np.abs(np.concatenate([values.ravel() for values in maps]))
    wanted = max(float(np.percentile(magnitudes, _SHOWN)), _LEAST_LIMIT)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * wanted))


def write_exr(path: Path, lights: Iterable[Light]) -> None:
    """Write pictures of light as one OpenEXR file: 32-bit floats, linear, a part each.

    Parts have the pictures' names, channels R, G and B or Y, and the attribute ``white`` with the
    radiance that the figure shows as white. The same pictures give the same bytes.

    Parameters
    ----------
    path : Path
        Its folder is there.
    lights : iterable of Light
        At least one. One that is there twice is written once.

    Raises
    ------
    InputError
        When different pictures have one name.
    StoreError
        When the file can't be written.
    """
    import OpenImageIO as oiio

    parts: dict[str, Light] = {}
    for light in lights:
        known = parts.setdefault(light.name, light)
        if not np.array_equal(known.radiance, light.radiance):
            raise InputError(f"{path.name}: different pictures of light called {light.name!r}")
    frame = np.max([light.radiance.shape[:2] for light in parts.values()], axis=0)
    specs = [_spec(light, frame) for light in parts.values()]
    partial = hidden_sibling(path, "partial.exr")
    output = oiio.ImageOutput.create("partial.exr")
    if output is None:
        raise StoreError(f"{path}: OpenImageIO was built without OpenEXR: {oiio.geterror()}")
    is_good = output.open(str(partial), tuple(specs))
    for index, (spec, light) in enumerate(zip(specs, parts.values(), strict=True)):
        is_good = is_good and (not index or output.open(str(partial), spec, "AppendSubimage"))
        pixels = np.ascontiguousarray(light.radiance, np.float32)
        is_good = is_good and output.write_image(pixels)
    if not (output.close() and is_good):
        partial.unlink(missing_ok=True)
        raise StoreError(f"{path}: can't be written: {output.geterror()}")
    partial.replace(path)


def _spec(light: Light, frame: NDArray[np.int64]) -> Any:
    """Describe a part; all parts of a file share one frame, at whose corner pictures lie."""
    import OpenImageIO as oiio

    height, width, channels = light.radiance.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.FLOAT)
    spec.channelnames = _GREY if channels == 1 else _COLOUR
    spec.full_height, spec.full_width = map(int, frame)
    for name, value in {
        "oiio:subimagename": light.name,
        "oiio:ColorSpace": "lin_rec709",
        "compression": "zip",
        "DateTime": "",  # the time of writing otherwise
        "white": light.white,
    }.items():
        spec.attribute(name, value)
    return spec


def read_exr(path: Path) -> Mapping[str, NDArray[np.float32]]:
    """Read the parts of a file of `write_exr` by their names.

    Returns
    -------
    mapping of str to ndarray of float32, shape (H, W, 1) or (H, W, 3)
        Channels Y, or R, G and B, in whatever order they stand in the file.

    Raises
    ------
    StoreError
        When the file can't be read.
    """
    import OpenImageIO as oiio

    parts: dict[str, NDArray[np.float32]] = {}
    count = max(oiio.ImageBuf(str(path)).nsubimages, 1)
    for index in range(count):
        picture = oiio.ImageBuf(str(path))
        pixels = picture.get_pixels(oiio.FLOAT) if picture.read(index, 0) else None
        if pixels is None:
            raise StoreError(f"{path}: can't be read as OpenEXR: {picture.geterror()}")
        names = list(picture.spec().channelnames)
        wanted = _COLOUR if set(_COLOUR) <= set(names) else _GREY
        name = picture.spec().getattribute("oiio:subimagename")
        parts[name] = pixels[..., [names.index(channel) for channel in wanted]]
    return parts
