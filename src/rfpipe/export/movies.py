"""Pictures in a row as a movie, by PyAV."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError, installing
from rfpipe.store.files import storage_errors, whole_file

MOVIE_FILES: dict[str, tuple[str, dict[str, str]]] = {
    ".mp4": ("libx264", {"crf": "16", "preset": "medium"}),
    ".webm": ("libvpx-vp9", {"crf": "22", "b": "0", "row-mt": "1", "cpu-used": "4"}),
}
"""Encoder and its options, near to lossless, by the end of a file's name."""

_BT709, _LIMITED_RANGE, _SRGB_CURVE = 1, 1, 13  # as H.273 numbers them


def write_movie(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write a movie, complete or not at all.

    Parameters
    ----------
    path : path
        Ends in ``.mp4`` (H.264) or ``.webm`` (VP9).
    pictures : iterable of ndarray of uint8, shape (H, W, 3)
        sRGB, all of one size. An odd side is filled up by repeating its last pixels, since both
        encoders keep colour for squares of four.
    fps : float
        Pictures a second, above 0.

    Raises
    ------
    InputError
        If the name ends otherwise, or fps is out of range.
    StoreError
        If the file can't be written, or PyAV isn't installed.
    """
    if path.suffix.lower() not in MOVIE_FILES:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(MOVIE_FILES)}")
    if not 0 < fps <= 1000:
        raise InputError(f"fps is {fps}; expected more than 0, at most 1000")
    try:
        import av
    except ImportError as error:
        raise StoreError(
            f"movies are written by PyAV, which can't be loaded: {error}. To install it, "
            f"{installing('export')}"
        ) from error
    with storage_errors(path, "writing", resumes=False), whole_file(path) as partial:
        try:
            _encode(partial, MOVIE_FILES[path.suffix.lower()], pictures, fps)
        except av.error.FFmpegError as error:
            if isinstance(error, OSError):
                raise
            raise StoreError(f"{path}: the movie can't be encoded: {error}") from error


def _encode(
    path: Path,
    encoder: tuple[str, dict[str, str]],
    pictures: Iterable[NDArray[np.uint8]],
    fps: float,
) -> None:
    import av
    from av.video.reformatter import ColorRange, Colorspace

    name, options = encoder
    with av.open(str(path), "w") as container:
        stream = container.add_stream(name, Fraction(fps).limit_denominator(1001), options)
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
