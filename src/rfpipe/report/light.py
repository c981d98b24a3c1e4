"""Light in figures: radiance with its exposure, tone-mapped for screens and kept in OpenEXR."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import StoreError
from rfpipe.pictures.images import srgb
from rfpipe.store.files import hidden_sibling
from rfpipe.units import RADIANCE_UNIT

ERROR_COLOURS = "RdBu_r"
"""Colours of error maps: blue where a relit picture is too dark, red where it is too bright."""

ERROR_LABEL = "relit \N{MINUS SIGN} truth,\n% of white"
"""Text at the scale of an error map."""

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
        return srgb(self.radiance * np.asarray(self.gain)[..., None], self.white)


def exposure_text(lights: Iterable[Light]) -> str:
    """Say in a sentence what a figure's pictures of light show as white; "" without any."""
    lights = list(lights)
    scenes: dict[str, dict[str, None]] = {}
    for light in lights:
        scenes.setdefault(f"{light.quantity} {light.white:.3g}", {})[light.of] = None
    if not scenes:
        return ""
    count = len({light.of for light in lights})
    whites = [
        white if len(of) == count else f"{white} ({', '.join(of)})" for white, of in scenes.items()
    ]
    return f"Exposure: white is {', '.join(whites)}; sRGB tones."


def error_map(relit: Light, truth: Light) -> NDArray[np.float64]:
    """Return relit minus true radiance over white, (H, W), brightened as the relit picture is.

    The mean over the channels.
    """
    difference = np.asarray(relit.radiance, np.float64) - truth.radiance
    return np.asarray(difference.mean(axis=-1) * relit.gain / relit.white)


def round_limit(maps: Sequence[NDArray[Any]]) -> float:
    """Return the end of a colour scale for some error maps: 1, 2 or 5 times a power of ten.

    All but the largest hundredth of the magnitudes lie within it.
    """
    magnitudes = np.abs(np.concatenate([values.ravel() for values in maps]))
    wanted = max(float(np.percentile(magnitudes, 99)), _LEAST_LIMIT)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * wanted))


def write_exr(path: Path, lights: Sequence[Light]) -> None:
    """Write pictures of light as one OpenEXR file: 32-bit floats, linear, a part each.

    Parts have the pictures' names, channels R, G and B or Y, and the attribute ``white`` with the
    radiance that the figure shows as white. The same pictures give the same bytes.

    Parameters
    ----------
    path : Path
        Its folder is there.
    lights : sequence of Light
        At least one, all of one shape, of different names.

    Raises
    ------
    StoreError
        When the file can't be written.
    """
    import OpenImageIO as oiio

    specs = []
    for light in lights:
        height, width, channels = light.radiance.shape
        spec = oiio.ImageSpec(width, height, channels, oiio.FLOAT)
        spec.channelnames = _GREY if channels == 1 else _COLOUR
        for name, value in {
            "oiio:subimagename": light.name,
            "oiio:ColorSpace": "lin_rec709",
            "compression": "zip",
            "DateTime": "",  # the time of writing otherwise
            "white": light.white,
        }.items():
            spec.attribute(name, value)
        specs.append(spec)
    partial = hidden_sibling(path, "partial.exr")
    output = oiio.ImageOutput.create("partial.exr")
    assert output is not None  # every wheel has OpenEXR
    is_good = output.open(str(partial), tuple(specs))
    for index, (spec, light) in enumerate(zip(specs, lights, strict=True)):
        is_good = is_good and (not index or output.open(str(partial), spec, "AppendSubimage"))
        pixels = np.ascontiguousarray(light.radiance, np.float32)
        is_good = is_good and output.write_image(pixels)
    if not (output.close() and is_good):
        partial.unlink(missing_ok=True)
        raise StoreError(f"{path}: can't be written: {output.geterror()}")
    partial.replace(path)
