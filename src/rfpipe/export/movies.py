"""Relit pictures, and movies of them by PyAV: a light that moves over the projector's rays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from math import cos, pi, sin
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError, StoreError, installing
from rfpipe.output import OUTPUTS, suffix_of, whole_file
from rfpipe.pictures.images import srgb
from rfpipe.transport.relightable import Relightable

Float = NDArray[np.float32]

PATHS = {
    "across": "a vertical bar from left to right",
    "down": "a horizontal bar from top to bottom",
    "circle": "a disc around the middle",
    "views": "one view after the other, of a light field",
}
"""How a light may move."""

_SIZE = 1 / 8  # of the shorter side
_CIRCLE = 0.3  # radius, of height and width
_WHITE = 99.9  # per cent of a frame's samples that are not cut off
_NEAR_LOSSLESS = {"crf": "16", "preset": "medium"}
_BT709, _LIMITED_RANGE, _SRGB_CURVE = 1, 1, 13  # as H.273 numbers them


def moving_light(path: str, shape: tuple[int, ...], time: float) -> Float:
    """Return the weights ``(*shape)`` of a light on one of `PATHS`, at a time from 0 to 1.

    Views are lit alike, but by ``views``. InputError if the path is none.
    """
    domain = RayDomain(shape)
    if path == "views" and domain.is_stack:
        weights = np.zeros(domain.stack_shape, np.float32)
        weights[min(int(time * domain.views), domain.views - 1)] = 1
        return weights.reshape(shape)
    height, width = domain.image_shape
    size = max(min(height, width) * _SIZE, 1.0)
    rows, columns = np.ogrid[0:height, 0:width]
    if path in ("across", "down"):
        place = columns if path == "across" else rows
        middle = -size / 2 + time * (place.size - 1 + size)  # from outside to outside
        distance = np.abs(place - middle)
    elif path == "circle":
        row = (height - 1) / 2 - _CIRCLE * height * cos(2 * pi * time)
        column = (width - 1) / 2 + _CIRCLE * width * sin(2 * pi * time)
        distance = np.hypot(rows - row, columns - column)
    else:
        raise InputError(f"path {path!r}: expected {', '.join(PATHS)} (for several views alone)")
    weights = np.clip(size / 2 + 0.5 - distance, 0, 1).astype(np.float32)  # an edge a ray wide
    return np.broadcast_to(weights, shape)


def relit_pictures(light: Relightable, patterns: Iterable[Float]) -> Iterator[Float]:
    """Yield the pictures ``(H, W, C)`` under patterns, radiance; views one above the other.

    Patterns are as `Relightable.relight` takes them.
    """
    shape = RayDomain(light.camera_shape).picture_shape
    for pattern in patterns:
        yield light.relight(pattern).reshape(*shape, light.channels)


def relit_movie(
    light: Relightable,
    file: Path,
    path: str = "across",
    count: int = 150,
    *,
    fps: float = 25,
    enlarge: int = 1,
    white: float | None = None,
    progress: bool = False,
) -> float:
    """Write the movie of a light that moves; return the radiance shown as white.

    Parameters
    ----------
    file : path
        Ends in ``.mp4``.
    path : str
        One of `PATHS`.
    count : int
        Number of pictures.
    fps : float
        Pictures a second.
    enlarge : int
        Pixels of a ray, down and across.
    white : float, optional
        Radiance shown as white; by default all but the brightest thousandth of the samples of the
        brightest picture are shown as they are, for which all is relit twice.
    progress : bool
        Whether to show on stderr how far it is, if that is a terminal.

    Raises
    ------
    InputError
        If a number is out of range, or the path or the name's end is another one.
    StoreError
        If the file can't be written, or PyAV isn't installed.
    """
    from tqdm import tqdm

    if count < 1 or fps <= 0:
        raise InputError(f"{count} pictures, {fps} a second; expected more than 0")

    def relit(what: str) -> Iterator[Float]:
        times = np.linspace(0, 1, count).tolist()
        patterns = (moving_light(path, light.projector_shape, time) for time in times)
        pictures = relit_pictures(light, patterns)
        bar = tqdm(pictures, what, count, unit="picture", disable=None if progress else True)
        return iter(bar)

    return movie_of(relit, file, fps=fps, enlarge=enlarge, white=white)


def movie_of(
    pictures: Callable[[str], Iterable[Float]],
    file: Path,
    *,
    fps: float = 25,
    enlarge: int = 1,
    white: float | None = None,
) -> float:
    """Write a movie of radiance, which is made twice without `white`, see `relit_movie`."""
    if white is not None and not 0 < white < float("inf"):
        raise InputError(f"white is {white}; expected more than 0")
    if white is None:
        white = white_of(pictures("white"))
    shown = (np.rint(255 * srgb(image, white)).astype(np.uint8) for image in pictures(str(file)))
    write_movie(file, (each.repeat(enlarge, 0).repeat(enlarge, 1) for each in shown), fps)
    return white


def white_of(pictures: Iterable[Float]) -> float:
    """Return the radiance that is white in all of some pictures: a glint may be cut off."""
    return max(float(np.percentile(image, _WHITE)) for image in pictures) or 1.0


def write_movie(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write sRGB pictures ``(H, W, 3)`` of one size as a movie (H.264), complete or not at all.

    An odd side is filled up by repeating its last pixels, since the encoder keeps colour for
    squares of four. Errors as `relit_movie`.
    """
    suffix_of(path, OUTPUTS["movie"])
    try:
        import av
    except ImportError as error:
        raise StoreError(
            f"movies are written by PyAV, which can't be loaded: {error}. To install it, "
            f"{installing('export')}"
        ) from error
    with whole_file(path) as partial:
        try:
            _encode(partial, pictures, fps)
        except av.error.FFmpegError as error:
            if isinstance(error, OSError):
                raise
            raise StoreError(f"{path}: the movie can't be encoded: {error}") from error


def _encode(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> None:
    import av
    from av.video.reformatter import ColorRange, Colorspace

    with av.open(str(path), "w") as container:
        rate = Fraction(fps).limit_denominator(1001)
        stream = container.add_stream("libx264", rate, _NEAR_LOSSLESS)
        assert isinstance(stream, av.VideoStream)
        stream.pix_fmt = "yuv420p"
        about = stream.codec_context
        about.colorspace = about.color_primaries = _BT709
        about.color_range, about.color_trc = _LIMITED_RANGE, _SRGB_CURVE
        for index, picture in enumerate(pictures):
            height, width = picture.shape[:2]
            even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), "edge")
            if not index:
                stream.height, stream.width = even.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), "rgb24")
            frame = frame.reformat(
                format="yuv420p",
                dst_colorspace=Colorspace.ITU709,
                dst_color_range=ColorRange.MPEG,
            )
            frame.pts = index
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
