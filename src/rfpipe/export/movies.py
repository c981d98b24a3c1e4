"""Relit pictures, and movies of a light that moves over the projector's rays, by PyAV."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from math import cos, pi, sin
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError, StoreError
from rfpipe.installation import needing
from rfpipe.output import OUTPUTS, suffix_of, whole_file
from rfpipe.pictures.images import srgb
from rfpipe.transport.relightable import Relightable

PATHS = {
    "across": "a vertical bar from left to right",
    "down": "a horizontal bar from top to bottom",
    "circle": "a disc around the centre",
    "views": "one view of a light field after the other",
}
"""Descriptions of the paths of a moving light."""

_SIZE = 1 / 8  # size of the light, relative to the shorter side
_CIRCLE = 0.3  # radius of the circle, relative to height and width
_WHITE = 99.9  # percentile of a picture's samples that becomes white
_NEAR_LOSSLESS = {"crf": "16", "preset": "medium"}
_BT709, _LIMITED_RANGE, _SRGB_CURVE = 1, 1, 13  # numbers of ITU-T H.273


def moving_light(path: str, shape: tuple[int, ...], time: float) -> Float:
    """Return the weights of a light that moves along a path.

    Parameters
    ----------
    path : str
        One of `PATHS`. Except for ``views``, the light is the same in all views.
    shape : tuple of int
        Projector's ray domain, (H, W) or (V, H, W).
    time : float
        Fraction of the path, 0 to 1.

    Returns
    -------
    ndarray
        (*shape) float32, 0 to 1.

    Raises
    ------
    InputError
        When there is no such path, or it needs several views.
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
        position = columns if path == "across" else rows
        centre = -size / 2 + time * (position.size - 1 + size)  # from edge to edge
        distance = np.abs(position - centre)
    elif path == "circle":
        row = (height - 1) / 2 - _CIRCLE * height * cos(2 * pi * time)
        column = (width - 1) / 2 + _CIRCLE * width * sin(2 * pi * time)
        distance = np.hypot(rows - row, columns - column)
    else:
        raise InputError(
            "unknown path of the light",
            value=path,
            remedy=f"expected {', '.join(PATHS)} (only for several views)",
        )
    weights = np.clip(size / 2 + 0.5 - distance, 0, 1).astype(
        np.float32
    )  # linear edges, one ray wide
    return np.broadcast_to(weights, shape)


def relit_pictures(light: Relightable, patterns: Iterable[Float]) -> Iterator[Float]:
    """Yield the radiance (H, W, C) under each pattern, with views stacked vertically.

    Patterns are those of `Relightable.relight`.
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
    """Write the movie of a moving light; return the radiance that becomes white.

    Parameters
    ----------
    light : Relightable
        The transport.
    file : path
        A file with the suffix ``.mp4``.
    path : str
        One of `PATHS`.
    count : int
        Number of pictures.
    fps : float
        Pictures per second.
    enlarge : int
        Side of a ray in pixels.
    white : float, optional
        Radiance that becomes white. By default, the 99.9th percentile of the brightest picture's
        samples, for which the scene is relit twice.
    progress : bool
        Display the progress on stderr, if that is a terminal.

    Raises
    ------
    InputError
        When a number is out of range, or the path or suffix is unknown.
    StoreError
        When the file can't be written, or PyAV isn't installed.
    """
    from tqdm import tqdm

    if count < 1 or fps <= 0:
        raise InputError(f"{count} pictures at {fps} per second; expected more than 0 of both")

    def relit(label: str) -> Iterator[Float]:
        times = np.linspace(0, 1, count).tolist()
        patterns = (moving_light(path, light.projector_shape, time) for time in times)
        pictures = relit_pictures(light, patterns)
        bar = tqdm(pictures, label, count, unit="picture", disable=None if progress else True)
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
    """Write a movie of pictures, which are rendered twice without `white`; see `relit_movie`."""
    if white is not None and not 0 < white < float("inf"):
        raise InputError(f"white is {white}; expected more than 0")
    if white is None:
        white = white_of(pictures("white"))
    frames = (np.rint(255 * srgb(image, white)).astype(np.uint8) for image in pictures(str(file)))
    write_movie(file, (frame.repeat(enlarge, 0).repeat(enlarge, 1) for frame in frames), fps)
    return white


def white_of(pictures: Iterable[Float]) -> float:
    """Return the largest 99.9th percentile of pictures, so that glints don't determine white."""
    return max(float(np.percentile(image, _WHITE)) for image in pictures) or 1.0


def write_movie(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write sRGB pictures (H, W, 3) of equal size as a movie (H.264), completely or not at all.

    The encoder needs even sides, since it stores colour at half the resolution; odd sides are
    extended by repeating the last pixels. Raises as `relit_movie`.
    """
    suffix_of(path, OUTPUTS["movie"])
    with needing("export", "writing a movie", StoreError):
        import av
    with whole_file(path) as partial:
        try:
            _encode(partial, pictures, fps)
        except av.error.FFmpegError as error:
            if isinstance(error, OSError):
                raise
            raise StoreError(f"the movie can't be encoded: {error}", place=path) from error


def _encode(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> None:
    import av
    from av.video.reformatter import ColorRange, Colorspace

    with av.open(str(path), "w") as container:
        rate = Fraction(fps).limit_denominator(1001)
        stream = container.add_stream("libx264", rate, _NEAR_LOSSLESS)
        assert isinstance(stream, av.VideoStream)
        stream.pix_fmt = "yuv420p"
        codec = stream.codec_context
        codec.colorspace = codec.color_primaries = _BT709
        codec.color_range, codec.color_trc = _LIMITED_RANGE, _SRGB_CURVE
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
