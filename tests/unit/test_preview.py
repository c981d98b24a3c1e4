"""The server's picture of the last bracket."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from rfpipe.photometry import CameraModel, MergeOptions
from rfpipe.server.api import preview_png

CAMERA = CameraModel(exposures=(0.1,))
FULL = CAMERA.white_level


def red_pixels(counts: np.ndarray) -> int:
    """Draw a bracket of one exposure, each count a pixel; return how much of it is red."""
    bracket = counts.astype(np.uint16)[None, ..., None]
    picture = np.asarray(Image.open(io.BytesIO(preview_png(bracket, CAMERA.describe()))), int)
    return int((picture[..., 0] > picture[..., 1] + 100).sum())


@pytest.mark.parametrize("below", [1, 2])
def test_pixels_are_red_where_the_merge_takes_none_of_them(below: int) -> None:
    first = int(np.ceil(0.98 * FULL))
    frames = np.full((1, 1, 4, 4, 1), first - below, np.uint16)
    frames[..., :2, :2, :] = first - below + 1
    merged = CAMERA.merge(
        frames, np.zeros(frames.shape[1:], np.float32), MergeOptions(black_count=1)
    )
    assert merged.saturated == (4 if below == 1 else 0)
    assert red_pixels(frames[0, 0, ..., 0]) == merged.saturated
