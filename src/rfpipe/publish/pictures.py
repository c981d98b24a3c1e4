"""The floodlit and the black picture of an acquisition, as files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.pictures.images import write_image
from rfpipe.publish.contents import Acquisition
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.merging.references import REFERENCES

__all__ = ["reference_pictures"]

# EXR files have the time of writing, which would change the bytes: that of the zip file's members.
_TIMELESS = {"DateTime": "1980:01:01 00:00:00"}


def reference_pictures(acquisition: Acquisition) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of an acquisition's reference pictures.

    The floodlit picture as radiance (EXR, float32) and for looking at (PNG, sRGB, its maximum
    white); the black level of each exposure in counts, as EXR. An acquisition whose merge store
    was removed has none.

    Raises
    ------
    IntegrityError
        When they are damaged.
    """
    folder = AcquisitionFolder(acquisition.folder)
    if not folder.store(0, REFERENCES).exists():
        return
    arrays, _ = folder.read(0, "merge", REFERENCES)
    where = f"pictures/{acquisition.scene}/{acquisition.method}"
    floodlit = arrays["floodlit"]
    stacked = _stacked(floodlit, tuple(acquisition.facts["camera_shape"]))
    for suffix in ("exr", "png"):
        yield f"{where}/floodlit.{suffix}", encoded(stacked, suffix)
    for exposure, counts in enumerate(arrays["black"]):
        # a mosaic's has no channels
        has_channels = counts.ndim > 2 and counts.shape[-1] in (1, 3)
        frame = counts if has_channels else counts[..., None]
        yield f"{where}/black_{exposure}.exr", encoded(_stacked(frame, frame.shape[:-1]), "exr")


def encoded(image: NDArray[Any], suffix: str) -> bytes:
    """Return a picture as the bytes of a file, the same ones each time.

    Raises
    ------
    InputError
        When it can't be written.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{suffix}"
        write_image(path, image, about=_TIMELESS)
        return path.read_bytes()


def _stacked(image: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an image ``(*shape, C)`` with its views one above the other."""
    return image.reshape(*RayDomain(shape).picture_shape, image.shape[-1])
